"""Messages that are joined from bytes equal those that the library encodes."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream import geometry as g
from roadperc_stream.geometry import rotations
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import set_stamp

STAMP = 1_600_000_000_000_000_123


def pose_at(x):
    return g.rigid(rotations.rotation_from_rpy(0.0, 0.1, 0.01 * x), np.array([x, -x, 0.0]))


def in_one_message(stamp_ns, frame_id, poses):
    message = PosesInFrame(frame_id=frame_id)
    set_stamp(message, stamp_ns)
    for matrix in poses:
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.position.z = matrix[:3, 3]
        q = pose.orientation
        q.x, q.y, q.z, q.w = rotations.quaternion(matrix[:3, :3])
    return message


@given(st.lists(st.floats(-1e3, 1e3), max_size=12), st.text(max_size=5), st.integers(0, 2**62))
def test_joined_poses_equal_the_bytes_of_one_message(places, frame_id, stamp_ns):
    poses = [pose_at(x) for x in places]

    data = encoding.encode_poses(stamp_ns, frame_id, poses)

    assert data == in_one_message(stamp_ns, frame_id, poses).SerializeToString()


def test_poses_in_column_order_give_the_same_bytes():
    pose = pose_at(3.0)

    assert encoding.encode_poses(STAMP, "odom", [np.asfortranarray(pose)]) == encoding.encode_poses(
        STAMP, "odom", [pose]
    )


def test_each_pose_is_encoded_once(monkeypatch: pytest.MonkeyPatch):
    encoded = []
    monkeypatch.setattr(encoding, "quaternion", lambda rotation: encoded.append(1) or rotations.quaternion(rotation))
    poses = [pose_at(7000.0 + k) for k in range(200)]  # beyond the places above: equal poses are cached

    for shown in range(1, len(poses) + 1):
        encoding.encode_poses(STAMP, "odom", poses[:shown])

    assert len(encoded) == len(poses)
