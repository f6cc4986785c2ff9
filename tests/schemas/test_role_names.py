import pytest

from roadperc_stream.schemas.role_names import role_of


@pytest.mark.parametrize(
    ("name", "role"),
    [
        *((name, "image") for name in ("rgb", "CameraRGB", "RGBCamera", "image", "images", "image_2", "image_02")),
        *((name, "image") for name in ("rgb_front", "front", "camera", "color", "Camera_Front", "frames")),
        *((name, "depth") for name in ("depth", "CameraDepth", "depth_front", "Depth", "depth_maps")),
        *((name, "segmentation") for name in ("segmentation", "seg", "sem", "semantic", "semantic_segmentation")),
        *((name, "segmentation") for name in ("semantic_segmentation_front", "CameraSeg", "labels", "tags")),
        *((name, "left") for name in ("left", "CameraLeft", "image_left", "Left")),
        *((name, "right") for name in ("right", "CameraRight", "image_right", "image_3", "image_03")),
        *((name, "instances") for name in ("instances", "instance_segmentation", "CameraInstanceSegmentation")),
        *((name, "detections") for name in ("detections", "label_2", "boxes")),
        *(
            (name, "lidar")
            for name in ("lidar", "LidarFront", "velodyne", "velodyne_points", "point_cloud", "PointCloud")
        ),
    ],
)
def test_folder_names_people_use(name, role):
    assert role_of(name) == role


@pytest.mark.parametrize(
    "name",
    [
        "",
        "misc",
        "depth_rear",
        "left_depth",
        "image_0",
        "lidar_rear",
        "semantic_lidar",
        "lidar_image",
        "rgb_depth",
        "left_right",
        "2",
    ],
)
def test_other_names_fit_no_role(name):
    assert role_of(name) is None
