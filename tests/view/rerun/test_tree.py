"""The drawn transform tree has one parent per frame, and the camera's mounting of the chain."""

import numpy as np
import pytest

from roadperc_stream.geometry import Camera, Plane, inverse, mounting, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.assemble import ego_T_camera_of
from roadperc_stream.model import DepthImage, Surface, Transform
from roadperc_stream.view.rerun import pictures, scene
from roadperc_stream.view.rerun.tree import SceneState


def edge(parent, child, x_m, roll=0.0, yaw=0.0):
    return Transform(parent, child, rigid(rotation_from_rpy(roll, 0.0, yaw), np.array([x_m, 0.5 * x_m, 0.3 * x_m])))


def camera(frame_id):
    return Camera(frame_id, 320, 240, 160.0, 160.0, 159.5, 119.5)


class Drawn:
    """The tree of the drawn entries; each frame has one entity and therefore one parent."""

    def __init__(self):
        self.edges = {}
        self.frame_at = {}

    def add(self, entries):
        for entry in entries:
            found = entry.archetype
            if found.archetype() == "rerun.archetypes.Transform3D":
                child, parent = (f.as_arrow_array().to_pylist()[0] for f in (found.child_frame, found.parent_frame))
                assert self.frame_at.setdefault(entry.entity, child) == child
                rotation = np.array(found.mat3x3.as_arrow_array().to_pylist()).reshape(3, 3, order="F")
                self.edges[child] = parent, rigid(rotation, np.array(found.translation.as_arrow_array().to_pylist()[0]))
        assert sorted(self.frame_at.values()) == sorted(self.edges)

    def ego_T(self, frame):
        """The pose of a frame below ego; None for other frames."""
        ego_T_frame, steps = np.eye(4), 0
        while frame in self.edges and steps <= len(self.edges):
            frame, parent_T_frame = self.edges[frame]
            ego_T_frame, steps = parent_T_frame @ ego_T_frame, steps + 1
        return ego_T_frame if frame == "ego" else None


FOOT, MOUNT = edge("base_footprint", "base_link", 0.4), edge("base_link", "camera", 1.1, roll=-1.5)
TREES = {
    "ego": ("camera", [[edge("ego", "camera", 1.4)]]),
    "foot first": ("camera", [[FOOT, MOUNT]]),
    "camera first": ("camera", [[MOUNT, FOOT]]),
    "two messages": ("camera", [[MOUNT], [FOOT]]),
    "foot below": ("camera", [[MOUNT], [edge("base_link", "base_footprint", -0.4, yaw=0.1)]]),
    "carla": ("ego_vehicle/rgb_front", [[edge("ego_vehicle", "ego_vehicle/rgb_front", 2.0)]]),
    "hero": ("rgb", [[edge("map", "hero", 7.0)], [edge("hero", "rgb", 2.0)]]),
    "a name of its own": ("truck7/rgb", [[edge("map", "truck7", 50.0), edge("truck7", "truck7/rgb", 2.0)]]),
    "moving": (
        "ego_vehicle/rgb",
        [
            [edge("map", "ego_vehicle", 50.0), edge("ego_vehicle", "ego_vehicle/rgb", 2.0)],
            [edge("map", "ego_vehicle", 51.0, yaw=0.2)],
        ],
    ),
    "turning camera": ("camera", [[FOOT, MOUNT], [edge("base_link", "camera", 1.1, yaw=0.3)]]),
    "camera moved to another parent": (
        "camera",
        [[FOOT, MOUNT], [Transform("base_footprint", "camera", MOUNT.parent_T_child)]],
    ),
    "an edge that closes a loop": ("camera", [[FOOT, MOUNT], [edge("camera", "base_footprint", 1.0)]]),
    "odometry": ("camera", [[edge("map", "odom", 3.0)], [edge("odom", "base_link", 9.0)], [MOUNT]]),
    "by odometry alone": ("camera", [[edge("odom", "base_link", 9.0), edge("odom", "camera", 8.0, yaw=0.1)]]),
    "ego below": ("camera", [[edge("map", "ego", 5.0)], [edge("ego", "camera", 1.4)]]),
}


@pytest.mark.parametrize("known_early", [True, False])
@pytest.mark.parametrize("role", ["tf", "tf_static"])
@pytest.mark.parametrize("name", TREES)
def test_the_camera_has_the_mounting_of_the_chain(name, role, known_early):
    """Holds after every message, with the calibration before or after the transforms."""
    frame_id, messages = TREES[name]
    state, drawn = SceneState(), Drawn()
    parts = [("/tf", role, tuple(message), state) for message in messages]
    steps = [(scene.transforms, part) for part in parts]
    steps.insert(
        0 if known_early else len(steps), (pictures.calibration, ("/c", "calibration", camera(frame_id), state))
    )
    for draw, part in steps:
        drawn.add(draw(*part))
        if state.front:
            found = placed(state, drawn, frame_id)
    assert found


def placed(state, drawn, frame_id):
    wanted, found = ego_T_camera_of(state.latched.tree, camera(frame_id)), drawn.ego_T(frame_id)
    assert (wanted is None) == (found is None)
    assert wanted is None or found == pytest.approx(wanted, abs=1e-5)
    assert "ego" not in drawn.edges  # odometry places it
    assert "odom" not in drawn.edges
    return wanted is not None


def with_camera(frame_id):
    """The state and the drawn tree after a calibration."""
    state, drawn = SceneState(), Drawn()
    drawn.add(pictures.calibration("/c", "calibration", camera(frame_id), state))
    return state, drawn


def test_frames_above_the_car_are_kept_below_it():
    state, drawn = with_camera("cam")
    above = edge("map", "base_link", 50.0, yaw=0.3)
    messages = (above, edge("base_link", "cam", 1.0)), (edge("map", "sign", 60.0),)
    for message in messages:
        drawn.add(scene.transforms("/tf", "tf", message, state))
    wanted = inverse(above.parent_T_child) @ messages[1][0].parent_T_child
    assert drawn.ego_T("sign") == pytest.approx(wanted, abs=1e-4)


def test_only_changed_edges_are_drawn_again():
    state = SceneState()
    state.latch("calibration", camera("camera"))
    assert len(list(scene.transforms("/tf", "tf", (FOOT, MOUNT), state))) == 3
    assert not list(scene.transforms("/tf", "tf", (FOOT, MOUNT), state))
    (again,) = scene.transforms("/tf", "tf", (edge("base_link", "camera", 1.2),), state)
    assert again.entity == "/tf/camera"


def surface(height_m):
    """A road 0.2 m below the ego origin, and a camera ``height_m`` above that origin."""
    plane = Plane((0.0, 0.0, 1.0), 0.2)
    return Surface("assumed", "", plane, plane, height_m + 0.2, 0.0, 0.0)


@pytest.mark.parametrize("frame_id", ["camera", "base_link"])
def test_a_camera_without_transforms_has_the_assumed_height(frame_id):
    """The vehicle frame is not optical, so its edge does not place a camera with that frame."""
    state, drawn = with_camera(frame_id)
    drawn.add(scene.transforms("/tf", "tf", (edge("ego", "base_link", 9.0), edge("map", "camera", 9.0)), state))
    drawn.add(e for e in scene.road("/perception/surface", "result", surface(1.7), state))
    assert drawn.ego_T(frame_id) == pytest.approx(mounting(z=1.7), abs=1e-6)
    assert "ego" not in drawn.edges


def test_a_later_transform_replaces_the_assumed_mounting():
    state, drawn = with_camera("camera")
    drawn.add(scene.road("/perception/surface", "result", surface(1.7), state))
    drawn.add(scene.transforms("/tf_static", "tf_static", (FOOT, MOUNT), state))
    assert placed(state, drawn, "camera")


def test_a_right_image_without_calibration_has_its_own_plane():
    state = SceneState()
    state.latch("calibration", camera("camera"))
    planes = {role: state.image_frame(role, f"{role}_camera") for role in ("image", "left", "depth", "right")}
    front = "camera_image_plane"
    assert planes == {"image": front, "left": front, "depth": front, "right": "right_camera_image_plane"}


@pytest.mark.parametrize(
    "odometry", [edge("odom", "ego", 3.0), edge("ego", "perception_odom", -3.0)], ids=["above", "below"]
)
def test_only_the_odometry_edges_of_results_are_drawn(odometry):
    """The edges between ego and the log's frames are already in the drawn tree."""
    ties = (edge("base_link", "ego", 0.0), edge("ego", "camera", 1.0))
    (drawn,) = scene.transforms("/perception/tf", "result", (*ties, odometry), SceneState())
    assert drawn.entity == f"/perception/tf/{odometry.child}"


@pytest.mark.parametrize(("role", "frame"), [("truth_pose", "odom of the log"), ("result", "odom")])
def test_poses_of_log_and_results_have_different_odom_frames(role, frame):
    state = SceneState()
    state.latch("tf", (edge("odom", "base_link", 9.0),))
    (arrow,) = scene.pose("/pose", role, edge("odom", "car", 2.0), state)
    assert arrow.frame == frame


def test_a_pose_in_an_odom_without_transforms_uses_the_odom_of_the_results():
    (arrow,) = scene.pose("/truth/pose", "truth_pose", edge("odom", "ego", 2.0), SceneState())
    assert arrow.frame == "odom"


def planes(entries):
    """(entity, image plane) of the pinholes of the entries."""
    found = ((e.entity, e.archetype) for e in entries if e.archetype.archetype() == "rerun.archetypes.Pinhole")
    return [(entity, pinhole.child_frame.as_arrow_array().to_pylist()[0]) for entity, pinhole in found]


def test_cameras_of_one_frame_draw_its_image_plane_once():
    """As the aligned depth of a RealSense, the left camera of a ZED, and a depth image of half the size."""
    state = SceneState()
    front, half = camera("camera"), Camera("camera", 160, 120, 80.0, 80.0, 79.5, 59.5)
    assert planes(pictures.calibration("/color", "calibration", front, state)) == [("/color", "camera_image_plane")]
    assert planes(pictures.calibration("/left", "left_calibration", front, state)) == []
    ((entity, plane),) = planes(pictures.calibration("/depth", "depth_calibration", half, state))
    assert (entity, plane != "camera_image_plane") == ("/depth", True)
    frames = {role: state.image_frame(role, "camera") for role in ("image", "left", "depth")}
    assert frames == {"image": "camera_image_plane", "left": "camera_image_plane", "depth": plane}
    picture = DepthImage("camera", lambda: (np.ones((120, 160), np.float32), 65.535))
    assert [entry.frame for entry in pictures.depth("/depth/image", "depth", picture, state)] == [plane]
    assert planes(pictures.calibration("/color", "calibration", front, state)) == [("/color", "camera_image_plane")]


def test_a_depth_image_without_calibration_shares_the_plane_of_its_frame():
    state = SceneState()
    for name, role in (("camera", "calibration"), ("left", "left_calibration")):
        list(pictures.calibration(f"/{name}", role, camera(name), state))
    picture = DepthImage("left", lambda: (np.ones((240, 320), np.float32), 65.535))
    (entry,) = pictures.depth("/depth", "depth", picture, state)
    assert entry.frame == "left_image_plane"
