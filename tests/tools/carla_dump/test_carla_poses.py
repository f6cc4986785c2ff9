import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import transform
from roadperc_stream.tools.carla_dump.truth_file import CarlaPose, camera_mounting, load_poses, right_handed
from tests.tools.dump_writer import document

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
ANGLES = st.floats(-180.0, 180.0)
METRES = st.floats(-1000.0, 1000.0)


def carla_matrix(pose: CarlaPose) -> np.ndarray:
    """As written in carla/geom/Transform.h, GetMatrix."""
    cy, sy = np.cos(np.radians(pose.yaw)), np.sin(np.radians(pose.yaw))
    cr, sr = np.cos(np.radians(pose.roll)), np.sin(np.radians(pose.roll))
    cp, sp = np.cos(np.radians(pose.pitch)), np.sin(np.radians(pose.pitch))
    return np.array(
        [
            [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr, pose.x],
            [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr, pose.y],
            [sp, -cp * sr, cp * cr, pose.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


@given(METRES, METRES, METRES, ANGLES, ANGLES, ANGLES)
def test_right_handed_pose_is_carlas_matrix_mirrored(x, y, z, roll, pitch, yaw):
    pose = CarlaPose(x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw)
    np.testing.assert_allclose(right_handed(pose), MIRROR @ carla_matrix(pose) @ MIRROR, atol=1e-9)


def test_a_camera_with_its_nose_up_looks_up():
    ego_T_camera = camera_mounting(CarlaPose(x=1.0, y=0.5, z=1.4, pitch=10.0))
    ahead = transform(ego_T_camera, np.array([0.0, 0.0, 1.0])) - ego_T_camera[:3, 3]
    np.testing.assert_allclose(ego_T_camera[:3, 3], [1.0, -0.5, 1.4])
    np.testing.assert_allclose(ahead, [np.cos(np.radians(10)), 0.0, np.sin(np.radians(10))], atol=1e-12)


def test_a_camera_turned_right_looks_right():
    ego_T_camera = camera_mounting(CarlaPose(z=1.4, yaw=90.0))
    ahead = transform(ego_T_camera, np.array([0.0, 0.0, 1.0])) - ego_T_camera[:3, 3]
    np.testing.assert_allclose(ahead, [0.0, -1.0, 0.0], atol=1e-12)


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
        ("poses.json", '{"0": {"location": {"x": 1, "y": 2}}}', "0.location.z: Field required"),
        ("poses.json", '{"a": 1}', "poses.json: a"),
        ("poses.csv", "1 0 0 0 1 0 0 0 1", "expected a header"),
        ("poses.csv", "", "expected a header"),
        ("poses.csv", "frame,x,y,z,roll,pitch,yaw\n1,2,3\n", "row 2: expected 7 values, got 3"),
        ("poses.csv", "frame,x,y,z,roll,pitch,yaw\n1,2,3,4,5,6,nan\n", "1.yaw"),
        ("poses.csv", "frame,x,y,z,roll,pitch,yaw\n1,2,3,4,5,6,7\n1,2,3,4,5,6,7\n", "stands twice"),
        ("poses.csv", "frame,x,y,z,roll,pitch,yaw\n1,2,3,4,5,6,7\n01,2,3,4,5,6,7\n", "both frame 1"),
    ],
)
def test_faults_name_file_and_key(tmp_path, name, text, fault):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(DumpError, match=fault) as caught:
        load_poses(path)
    assert name in str(caught.value)
