"""Names of stages, topics, and schemas of results."""

from collections.abc import Collection, Mapping
from typing import Final, Literal

IMAGE_SCHEMA: Final = "foxglove.CompressedImage"
VIDEO_SCHEMAS: Final = (
    "foxglove.CompressedVideo",
    "foxglove_msgs/msg/CompressedVideo",
    "foxglove_msgs/CompressedVideo",
)
CALIBRATION_SCHEMA: Final = "foxglove.CameraCalibration"
POINTS_SCHEMA: Final = "foxglove.PointCloud"
ROS_IMAGE_SCHEMA: Final = "sensor_msgs/msg/Image"
ROS_GRID_SCHEMA: Final = "nav_msgs/msg/OccupancyGrid"


STAGES: Final = ("stereo", "surface", "odometry", "lanes", "objects", "occupancy")
"""Stages in the order of execution; each has a section in the configuration."""
NEEDS: Final = {"odometry": ("surface",), "lanes": ("surface",), "occupancy": ("surface",)}
"""Stages that a stage needs. Without depth, odometry takes its scale from the road."""


def switched_off(stage: str) -> str:
    """Return the setting that switches a stage off."""
    return "stereo.method=off" if stage == "stereo" else f"{stage}.enabled=false"


RESULT_PREFIX: Final = "/perception/"
"""Prefix of the topics of results."""
DEBUG_PREFIX: Final = "/perception/debug/"
"""Prefix of the topics of pictures that show intermediate results of a stage."""
SURFACE_TOPIC: Final = "/perception/surface"
DRIVABLE_TOPIC: Final = "/perception/drivable"
DRIVABLE_SCENE_TOPIC: Final = "/perception/drivable/scene"
OCCUPANCY_TOPIC: Final = "/perception/occupancy"
LANES_TOPIC: Final = "/perception/lanes"
LANES_ANNOTATIONS_TOPIC: Final = "/perception/lanes/annotations"
LANES_SCENE_TOPIC: Final = "/perception/lanes/scene"
OBJECTS_TOPIC: Final = "/perception/objects"
OBJECTS_ANNOTATIONS_TOPIC: Final = "/perception/objects/annotations"
OBJECTS_SCENE_TOPIC: Final = "/perception/objects/scene"
STEREO_DEPTH_TOPIC: Final = "/perception/stereo/depth"
ODOMETRY_TOPIC: Final = "/perception/odometry"
ODOMETRY_STATE_TOPIC: Final = "/perception/odometry/state"
TRAJECTORY_TOPIC: Final = "/perception/trajectory"
TF_TOPIC: Final = "/perception/tf"
METRICS_TOPIC: Final = "/perception/metrics"
LOG_TOPIC: Final = "/perception/log"
OVERLAY_TOPIC: Final = "/perception/overlay"
DEBUG_SURFACE_TOPIC: Final = "/perception/debug/surface"
DEBUG_LANES_TOPIC: Final = "/perception/debug/lanes"
DEBUG_MATCHES_TOPIC: Final = "/perception/debug/matches"
DEBUG_TEMPLATE_TOPIC: Final = "/perception/debug/template"
DEBUG_DISPARITY_TOPIC: Final = "/perception/debug/disparity"
TIMES_TOPIC: Final = "/perception/times"

RESULTS: Final[Mapping[str, str]] = {
    SURFACE_TOPIC: "roadperc.Surface",
    DRIVABLE_TOPIC: IMAGE_SCHEMA,
    DRIVABLE_SCENE_TOPIC: "foxglove.SceneUpdate",
    OCCUPANCY_TOPIC: ROS_GRID_SCHEMA,
    LANES_TOPIC: "roadperc.Lanes",
    LANES_ANNOTATIONS_TOPIC: "foxglove.ImageAnnotations",
    LANES_SCENE_TOPIC: "foxglove.SceneUpdate",
    OBJECTS_TOPIC: "roadperc.Objects",
    OBJECTS_ANNOTATIONS_TOPIC: "foxglove.ImageAnnotations",
    OBJECTS_SCENE_TOPIC: "foxglove.SceneUpdate",
    STEREO_DEPTH_TOPIC: ROS_IMAGE_SCHEMA,
    ODOMETRY_TOPIC: "foxglove.PoseInFrame",
    ODOMETRY_STATE_TOPIC: "roadperc.Odometry",
    TRAJECTORY_TOPIC: "foxglove.PosesInFrame",
    TF_TOPIC: "foxglove.FrameTransforms",
    METRICS_TOPIC: "roadperc.FrameMetrics",
    LOG_TOPIC: "foxglove.Log",
}
"""Result topics and their schemas, in the order of registration."""

Request = Literal["overlay", "debug"]
ON_REQUEST: Final[Mapping[str, Request]] = {
    OVERLAY_TOPIC: "overlay",
    DEBUG_SURFACE_TOPIC: "debug",
    DEBUG_LANES_TOPIC: "debug",
    DEBUG_MATCHES_TOPIC: "debug",
    DEBUG_TEMPLATE_TOPIC: "debug",
    DEBUG_DISPARITY_TOPIC: "debug",
}
"""Topics of pictures (foxglove.CompressedImage) that are made on request, with the name of the request."""

LIVE_ONLY: Final[Mapping[str, str]] = {TIMES_TOPIC: "roadperc.StageTimes"}
"""Topics that only a live server publishes: stage times differ between replays, and a log's bytes must not."""


def result_schemas(requests: Collection[Request]) -> dict[str, str]:
    """Return topics and schemas of a replay's results, including the requested pictures."""
    return dict(RESULTS) | {topic: IMAGE_SCHEMA for topic, request in ON_REQUEST.items() if request in requests}
