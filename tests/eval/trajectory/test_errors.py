"""Alignments and errors with hand-computed answers, and pairs against a plain search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.errors import TableError
from roadperc_stream.eval.trajectory.errors import (
    Delta,
    absolute_errors_m,
    align,
    pairs,
    path_m,
    relative_errors,
    segment_errors,
    umeyama,
)
from tests.eval.trajectory.paths import helix, poses_at, rigid, scaled, straight

TRUE = helix(80)


def rmse_m(estimated, true, alignment):
    errors = absolute_errors_m(align(estimated, true, alignment).poses(estimated), true)
    return float(np.sqrt(np.mean(errors**2)))


@pytest.mark.parametrize("alignment", ["se3", "sim3", "origin", "none"])
def test_a_path_is_aligned_to_itself(alignment):
    found = align(TRUE, TRUE, alignment)
    np.testing.assert_allclose(found.poses(TRUE), TRUE, atol=1e-12)
    assert found.scale == pytest.approx(1.0, abs=1e-14)


def test_se3_undoes_a_rotation_and_a_translation():
    moved = rigid(1) @ TRUE
    np.testing.assert_allclose(align(moved, TRUE, "se3").poses(moved), TRUE, atol=1e-11)
    np.testing.assert_allclose(align(moved, TRUE, "origin").poses(moved), TRUE, atol=1e-11)
    assert rmse_m(moved, TRUE, "none") > 1


def test_the_axes_are_rotated_and_not_scaled():
    turned = align(rigid(2) @ scaled(TRUE, 3.0), TRUE, "sim3").poses(rigid(2) @ scaled(TRUE, 3.0))
    np.testing.assert_allclose(np.linalg.det(turned[:, :3, :3]), 1.0, atol=1e-12)
    np.testing.assert_array_equal(turned[:, 3], np.tile([0.0, 0, 0, 1], (len(TRUE), 1)))


def test_a_straight_path_is_aligned_without_error():
    line = straight(20, 0.5)
    assert max(rmse_m(rigid(3) @ line, line, alignment) for alignment in ("se3", "sim3")) < 1e-12


def test_only_sim3_undoes_a_scale():
    grown = scaled(TRUE, 2.5)
    found = align(grown, TRUE, "sim3")
    assert found.scale == pytest.approx(0.4, rel=1e-12)
    np.testing.assert_allclose(found.poses(grown), TRUE, atol=1e-11)
    assert all(rmse_m(grown, TRUE, alignment) > 1 for alignment in ("se3", "origin", "none"))


def test_a_mirrored_path_stays_mirrored():
    mirrored = TRUE.copy()
    mirrored[:, 2, 3] *= -1
    assert np.linalg.det(align(mirrored, TRUE, "se3").rotation) == pytest.approx(1.0)
    assert rmse_m(mirrored, TRUE, "se3") > 0.05


def test_the_scale_is_that_of_least_squares():
    """The common extent is 2 m2; the paths' own extents are 2 m2 and 8 m2."""
    line = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    bumpy = np.array([[-1.0, 1, 0], [0, -2, 0], [1, 1, 0]])
    assert umeyama(line, bumpy, with_scale=True).scale == pytest.approx(1.0, rel=1e-12)
    assert umeyama(bumpy, line, with_scale=True).scale == pytest.approx(1 / 4, rel=1e-12)


def test_a_standing_car_is_aligned_but_has_no_scale():
    standing = straight(10, 0.0)
    assert rmse_m(rigid(4) @ standing, standing, "se3") < 1e-12
    for estimated, true in ((standing, TRUE[:10]), (TRUE[:10], standing), (standing, standing)):
        with pytest.raises(
            TableError, match=r"no Sim\(3\) alignment, because the scale is unknown: one of the paths stands still"
        ):
            align(estimated, true, "sim3")


def test_a_relative_error_is_in_the_moving_frame():
    """The car turns left by 90 degrees and drives 4 m; the estimate misses 3 m to the side and turns 60 degrees."""
    quarter = np.pi / 2
    true = poses_at(np.array([[0.0, 0, 0], [0, 4, 0]]), np.array([[0, 0, quarter], [0, 0, quarter]]))
    estimated = poses_at(np.array([[9.0, 9, 9], [13, 6, 9]]), np.array([[0, 0, 0], [0, 0, np.pi / 3]]))
    off_m, off_deg = relative_errors(estimated, true, *pairs(true, Delta(1, "frames")))
    assert off_m == pytest.approx([3.0])
    assert off_deg == pytest.approx([60.0])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 2.0, np.pi - 1e-9, np.pi])
def test_angles_are_exact_also_near_zero_and_half_a_turn(angle):
    true = straight(2, 1.0)
    estimated = poses_at(true[:, :3, 3], np.array([[0, 0, 0], [0, 0, angle]]))
    _, off_deg = relative_errors(estimated, true, *pairs(true, Delta(1, "frames")))
    assert off_deg == pytest.approx([np.degrees(angle)], rel=1e-6, abs=1e-15)


def test_pairs_of_frames():
    first, second = pairs(straight(5, 1.0), Delta(3, "frames"))
    assert (first.tolist(), second.tolist()) == ([0, 1], [3, 4])
    assert [len(part) for part in pairs(straight(5, 1.0), Delta(5, "frames"))] == [0, 0]


@settings(max_examples=200)
@given(
    steps_m=st.lists(st.one_of(st.just(0.0), st.floats(0.001, 3.0)), min_size=1, max_size=40),
    length_m=st.floats(0.01, 10.0),
)
def test_pairs_in_metres_equal_those_of_a_plain_search(steps_m, length_m):
    path = poses_at(np.outer(np.concatenate(([0.0], np.cumsum(steps_m))), [1.0, 0, 0]))
    driven_m = path_m(path)
    expected = []
    for i in range(len(driven_m) - 1):
        off_m = np.abs(driven_m[i + 1 :] - driven_m[i] - length_m)
        if off_m.min() <= 0.1 * length_m:
            expected.append((i, i + 1 + int(np.argmin(off_m))))
    first, second = pairs(path, Delta(length_m, "metres"))
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == expected


def test_kittis_errors_of_a_path_that_is_a_tenth_too_long():
    """Steps of 1 m; a stretch of 10 m ends at the first pose beyond, after 11 m, with an error of 1.1 m."""
    true = straight(40, 1.0)
    percent, deg = segment_errors(scaled(true, 1.1), true, 10.0, 10)
    np.testing.assert_allclose(percent, [11.0, 11.0, 11.0])
    np.testing.assert_allclose(deg, 0.0)


def test_kittis_errors_of_a_path_that_bends():
    """0.1 degrees per metre are 10 degrees in 100 m; a stretch is 101 m long."""
    true = straight(250, 1.0)
    rotvecs = np.outer(np.deg2rad(0.1) * np.arange(250), [0, 0, 1.0])
    estimated = poses_at(true[:, :3, 3], rotvecs)
    _, deg = segment_errors(estimated, true, 100.0, 10)
    assert len(deg) == 15
    np.testing.assert_allclose(deg, 10.1)
    assert [len(part) for part in segment_errors(true[:101], true[:101], 100.0, 1)] == [0, 0]
