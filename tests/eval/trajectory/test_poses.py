"""The poses of a table, and the exported lines read by independent code."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roadperc_stream.errors import TableError
from roadperc_stream.eval.trajectory.poses import kitti_lines, read_poses, tum_lines
from tests.eval.tables import START_NS, STEP_NS, row, run_of, write
from tests.eval.trajectory.paths import columns, helix, noisy, rigid, write_run

TRUE = rigid(1) @ helix(6)
ESTIMATED = noisy(TRUE, 1)


def read(path):
    return read_poses(run_of(path))


def with_hole(values, at, hole=None):
    return [hole if k == at else value for k, value in enumerate(values)]


def test_poses_are_read_as_written(tmp_path):
    found = read(write_run(tmp_path / "drive.metrics.parquet", ESTIMATED, TRUE))
    np.testing.assert_allclose(found.estimated, ESTIMATED, atol=1e-14)
    np.testing.assert_allclose(found.true, TRUE, atol=1e-14)
    assert found.stamps_ns.tolist() == [START_NS + k * STEP_NS + 123_456_789 for k in range(6)]
    assert (found.frames, found.estimated_frames, found.true_frames, found.coverage) == (6, 6, 6, 1.0)
    assert (found.name, found.lost, found.steps, found.without_scale) == ("drive", 0, 5, 0)


def test_a_frame_without_either_pose_is_left_out_and_counted(tmp_path):
    holes = {
        "odom_y_m": with_hole(ESTIMATED[:, 1, 3], 1),
        "true_qz": with_hole(columns("true", TRUE)["true_qz"], 2, np.nan),
        "odometry_status": with_hole(["first"] + ["tracked"] * 5, 3, "lost"),
    }
    found = read(write_run(tmp_path / "drive.metrics.parquet", ESTIMATED, TRUE, **holes))
    assert (found.estimated_frames, found.true_frames, found.lost) == (4, 5, 1)
    assert found.coverage == 0.5
    np.testing.assert_allclose(found.true, TRUE[[0, 4, 5]], atol=1e-14)
    np.testing.assert_allclose(found.estimated, ESTIMATED[[0, 4, 5]], atol=1e-14)
    assert found.stamps_ns[1] - found.stamps_ns[0] == 4 * STEP_NS


ZEROS = {f"true_{name}": [0.0] + [0.5] * 5 for name in ("qx", "qy", "qz", "qw")}
BEYOND = {"true_x_m": 1e90, "true_qy": -1e90, "true_qw": np.inf}


@pytest.mark.parametrize(
    "holes", [ZEROS, *({name: with_hole(columns("true", TRUE)[name], 2, value)} for name, value in BEYOND.items())]
)
def test_zero_quaternions_and_values_out_of_range_are_not_poses(tmp_path, holes):
    found = read(write_run(tmp_path / "drive.metrics.parquet", ESTIMATED, TRUE, **holes))
    assert (found.true_frames, len(found.true)) == (5, 5)


@pytest.mark.parametrize("true", [{}, {"true_x_m": [None] * 6}])
def test_without_truth_all_estimates_are_read(tmp_path, true):
    found = read(write_run(tmp_path / "drive.metrics.parquet", ESTIMATED, TRUE if true else None, **true))
    assert found.true is None
    assert (len(found.estimated), found.true_frames, found.coverage) == (6, 0, 1.0)


@pytest.mark.parametrize("rows", [[], [row(0), row(1)]])
def test_a_run_without_odometry_is_an_error(tmp_path, rows):
    path = write(tmp_path / "drive.metrics.parquet", rows)
    with pytest.raises(TableError, match=r"drive\.metrics\.parquet: no frame has an estimated pose"):
        read(path)


def test_a_column_of_another_type_is_an_error(tmp_path):
    path = write_run(tmp_path / "drive.metrics.parquet", ESTIMATED, TRUE, true_x_m=["far"] * 6)
    with pytest.raises(TableError, match=r"drive\.metrics\.parquet: "):
        read(path)


def test_steps_without_scale_have_a_turn_but_no_length(tmp_path):
    most = {"step_m": [None, None, None, None, 0.5, 0.5]}
    found = read(write_run(tmp_path / "most.metrics.parquet", ESTIMATED, TRUE, **most))
    assert (found.steps, found.without_scale, found.up_to_scale) == (5, 3, True)
    some = read(write_run(tmp_path / "some.metrics.parquet", ESTIMATED, TRUE, step_m=[None, None, None, 0.5, 0.5, 0.5]))
    assert (some.without_scale, some.up_to_scale) == (2, False)


PATH = rigid(1) @ helix(5)


def test_tum_lines_have_nanoseconds_and_all_digits():
    stamps_ns = np.array([0, 1, 1_577_836_800_123_456_789, 1_577_836_801_000_000_000, 2**62])
    rows = [line.split(" ") for line in tum_lines(stamps_ns, PATH)]
    assert [row[0] for row in rows] == [
        *("0.000000000", "0.000000001", "1577836800.123456789", "1577836801.000000000", "4611686018.427387904"),
    ]
    values = np.array([row[1:] for row in rows], float)
    np.testing.assert_array_equal(values[:, :3], PATH[:, :3, 3])
    np.testing.assert_allclose(Rotation.from_quat(values[:, 3:]).as_matrix(), PATH[:, :3, :3], atol=1e-15)
    assert (values[:, 6] >= 0).all()


def test_kitti_lines_are_relative_to_the_first_pose():
    rows = np.array([line.split(" ") for line in kitti_lines(PATH)], float)
    assert rows.shape == (5, 12)
    np.testing.assert_allclose(rows[0], np.eye(4)[:3].ravel(), atol=1e-14)
    read = np.tile(np.eye(4), (5, 1, 1))
    read[:, :3] = rows.reshape(5, 3, 4)
    np.testing.assert_allclose(PATH[0] @ read, PATH, atol=1e-12)
    assert not set("".join(kitti_lines(PATH))) - set("0123456789.-+e ")
