"""The files, read back without the code that wrote them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roadperc_stream.eval.trajectories.files import kitti_lines, tum_lines
from tests.eval.trajectories.paths import helix, rigid

PATH = rigid(1) @ helix(5)


def test_tum_lines_hold_nanoseconds_and_every_digit():
    stamps_ns = np.array([0, 1, 1_577_836_800_123_456_789, 1_577_836_801_000_000_000, 2**62])
    rows = [line.split(" ") for line in tum_lines(stamps_ns, PATH)]
    assert [row[0] for row in rows] == [
        *("0.000000000", "0.000000001", "1577836800.123456789", "1577836801.000000000", "4611686018.427387904"),
    ]
    values = np.array([row[1:] for row in rows], float)
    np.testing.assert_array_equal(values[:, :3], PATH[:, :3, 3])
    np.testing.assert_allclose(Rotation.from_quat(values[:, 3:]).as_matrix(), PATH[:, :3, :3], atol=1e-15)
    assert (values[:, 6] >= 0).all()


def test_kitti_lines_are_against_the_first_pose():
    rows = np.array([line.split(" ") for line in kitti_lines(PATH)], float)
    assert rows.shape == (5, 12)
    np.testing.assert_allclose(rows[0], np.eye(4)[:3].ravel(), atol=1e-14)
    read = np.tile(np.eye(4), (5, 1, 1))
    read[:, :3] = rows.reshape(5, 3, 4)
    np.testing.assert_allclose(PATH[0] @ read, PATH, atol=1e-12)


@pytest.mark.parametrize("lines", [kitti_lines, lambda poses: tum_lines(np.zeros(len(poses), np.int64), poses)])
def test_plain_numbers(lines):
    assert not set("".join(lines(PATH))) - set("0123456789.-+e ")
