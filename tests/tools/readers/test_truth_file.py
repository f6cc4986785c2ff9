import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.config.calibration import CarlaPose
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import rigid, transform
from roadperc_stream.input.calibrations import camera_mounting, right_handed
from roadperc_stream.model import Box
from roadperc_stream.tools.readers.truth_file import load_poses, load_truth
from tests.tools.dump_writer import document
from tests.tools.rendered import carla_rotation

MIRROR = np.diag([1.0, -1.0, 1.0])
ANGLES = st.floats(-180.0, 180.0)
METRES = st.floats(-1000.0, 1000.0)


@given(METRES, METRES, METRES, ANGLES, ANGLES, ANGLES)
def test_right_handed_pose_is_carlas_matrix_mirrored(x, y, z, roll, pitch, yaw):
    found = right_handed(CarlaPose(x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw))
    expected = rigid(MIRROR @ carla_rotation(roll, pitch, yaw) @ MIRROR, np.array([x, -y, z]))
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("pitch", "yaw", "looks"),
    [(10.0, 0.0, [np.cos(np.radians(10)), 0.0, np.sin(np.radians(10))]), (0.0, 90.0, [0.0, -1.0, 0.0])],
    ids=["up", "right"],
)
def test_a_camera_looks_where_it_is_turned(pitch, yaw, looks):
    ego_T_camera = camera_mounting(CarlaPose(x=1.0, y=0.5, z=1.4, pitch=pitch, yaw=yaw))
    ahead = transform(ego_T_camera, np.array([0.0, 0.0, 1.0])) - ego_T_camera[:3, 3]
    np.testing.assert_allclose(ego_T_camera[:3, 3], [1.0, -0.5, 1.4])
    np.testing.assert_allclose(ahead, looks, atol=1e-12)


EXPECTED = {7: CarlaPose(x=1, y=2, z=3, roll=4, pitch=5, yaw=6)}


def test_poses_of_json(tmp_path):
    entry = {"location": {"x": 1, "y": 2, "z": 3}, "rotation": {"pitch": 5, "yaw": 6, "roll": 4}}
    poses = load_poses(document(tmp_path / "poses.json", {"000007": entry}))
    np.testing.assert_allclose(poses[7], right_handed(EXPECTED[7]))


@pytest.mark.parametrize(
    "text", ["frame,x,y,z,roll,pitch,yaw\n7,1,2,3,4,5,6\n", "yaw pitch roll z y x frame speed\n6 5 4 3 2 1 000007 9\n"]
)
def test_poses_of_tables(tmp_path, text):
    path = tmp_path / "poses.txt"
    path.write_text(text)
    np.testing.assert_allclose(load_poses(path)[7], right_handed(EXPECTED[7]))


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("poses.json", "{", "not JSON"),
        ("poses.json", '{"0": {"location": {"x": 1, "y": 2}}}', "0.location.z: missing"),
        ("poses.csv", "1 0 0 0 1 0 0 0 1", "expected a header"),
        ("poses.csv", "frame,x,y,z,roll,pitch,yaw\n1,2,3\n", "row 2: expected 7 values, got 3"),
        ("poses.csv", "frame,x,y,z,roll,pitch,yaw\n1,2,3,4,5,6,7\n01,2,3,4,5,6,7\n", "both frame 1"),
    ],
)
def test_faults_name_file_and_key(tmp_path, name, text, fault):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(DumpError, match=fault) as caught:
        load_poses(path)
    assert name in str(caught.value)


SIDE = {"offset_m": 1.7, "heading": 0.01, "curvature_per_m": 0.002, "inside": "road", "outside": "sidewalk"}
GRID = {"x_min_m": 0.0, "y_min_m": -1.0, "step_m": 0.5, "columns": 3, "rows": 2, "z_m": [0, 1, 2, 3, 4, 5]}
SURFACE = {
    "normal": [0.0, -2.0, 0.0],
    "camera_height_m": 1.4,
    "pitch": 0.01,
    "roll": -0.02,
    "a": 0.1,
    "b": -0.2,
    "d": 0.3,
    "height_grid": GRID,
}
OBJECT = {"id": 7, "label": "Car", "box_px": [1, 2, 3, 4], "distance_m": 12.5, "closing_speed_mps": None}
TRUTH = {
    "lanes": {"000003": {"left": {**SIDE, "line_ego_m": [[0, 1.7, 0], [1, 1.71, 0]]}, "right": None}},
    "surface": {"000003": SURFACE},
    "objects": {"000003": [OBJECT]},
}


def test_truth_by_frame(tmp_path):
    truth = load_truth(document(tmp_path / "truth.json", TRUTH), "camera_depth")
    (left,) = truth.lanes[3].boundaries
    assert (left.side, left.status, left.offset_m, left.outside) == ("left", "measured", 1.7, "sidewalk")
    np.testing.assert_array_equal(left.line_ego_m, [[0, 1.7, 0], [1, 1.71, 0]])
    surface = truth.surfaces[3]
    assert (surface.source, surface.frame_id, surface.camera_height_m) == ("truth", "camera_depth", 1.4)
    assert surface.plane.normal == (0.0, -1.0, 0.0)
    assert surface.plane.offset_m == 1.4
    np.testing.assert_allclose(surface.abd, (0.1, -0.2, 0.3))
    assert surface.height_grid is not None
    np.testing.assert_array_equal(surface.height_grid.z_m, [[0, 1, 2], [3, 4, 5]])
    (item,) = truth.objects[3].objects
    assert (item.kept, item.track_id, item.distance_m, item.closing_speed_mps) == (True, "7", 12.5, None)
    assert item.detection.box_px == Box(1, 2, 3, 4)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"lanes": {"0": {"left": {"offset_m": 1.0}}}}, r"lanes\.0\.left\.heading: missing"),
        ({"surface": {"0": {**SURFACE, "camera_height_m": 0}}}, r"surface\.0\.camera_height_m"),
        ({"surface": {"0": {**SURFACE, "normal": [0, 0, 0]}}}, "surface of frame 0: normal is zero"),
        ({"surface": {"0": {**SURFACE, "height_grid": {**GRID, "rows": 3}}}}, "6 heights for 3 rows x 3 columns"),
        ({"objects": {"0": [{**OBJECT, "box_px": [3, 2, 1, 4]}]}}, "objects of frame 0: box"),
        ({"objects": {"0": [{**OBJECT, "distance_m": float("inf")}]}}, r"objects\.0\[0\]\.distance_m"),
    ],
)
def test_faults_of_truth_name_file_and_key(tmp_path, change, fault):
    with pytest.raises(DumpError, match=fault) as caught:
        load_truth(document(tmp_path / "truth.json", change), "camera_front")
    assert "truth.json" in str(caught.value)
