"""Poses are encoded once, whatever their memory layout."""

import numpy as np

from roadperc_stream import geometry as g
from roadperc_stream.geometry import rotations
from roadperc_stream.output import encoding

STAMP = 1_600_000_000_000_000_123


def pose_at(x):
    return g.rigid(rotations.rotation_from_rpy(0.0, 0.1, 0.01 * x), np.array([x, -x, 0.0]))


def test_poses_in_column_order_give_the_same_bytes():
    pose = pose_at(3.0)

    assert encoding.encode_poses(STAMP, "odom", [np.asfortranarray(pose)]) == encoding.encode_poses(
        STAMP, "odom", [pose]
    )
