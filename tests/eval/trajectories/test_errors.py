"""Absolute, relative and KITTI's errors: answers worked out by hand, and the pairs against a plain search."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.eval.trajectories.errors import (
    Delta,
    ErrorStatistics,
    absolute_errors_m,
    pairs,
    path_m,
    relative_errors,
    segment_errors,
)
from tests.eval.trajectories.paths import helix, noisy, poses_at, rigid, scaled, straight


def test_statistics_of_a_3_4_5_triangle():
    found = ErrorStatistics.of(np.array([3.0, 4.0, 5.0]))
    assert (found.count, found.mean, found.median, found.least, found.most, found.sse) == (3, 4.0, 4.0, 3.0, 5.0, 50.0)
    assert found.rmse == pytest.approx(np.sqrt(50 / 3))
    assert found.std == pytest.approx(np.sqrt(2 / 3))


def test_absolute_error_of_a_3_4_5_triangle():
    true = poses_at(np.zeros((2, 3)))
    estimated = poses_at(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(absolute_errors_m(estimated, true), [5.0, 0.0])


def test_nothing_is_wrong_with_the_same_path():
    path = helix(200)
    for delta in (Delta(1, "frames"), Delta(5.0, "metres")):
        off_m, off_deg = relative_errors(path, path, *pairs(path, delta))
        assert len(off_m) > 100
        assert off_m.max() < 1e-12
        assert off_deg.max() < 1e-12
    percent, deg = segment_errors(path, path, 50.0, 1)
    assert len(percent) > 100
    assert max(percent.max(), deg.max()) < 1e-12


def test_a_relative_error_is_in_the_moving_frame():
    """The car turns left by 90 degrees and drives 4 m; the estimate misses 3 m to the side and turns 60 degrees."""
    quarter = np.pi / 2
    true = poses_at(np.array([[0.0, 0, 0], [0, 4, 0]]), np.array([[0, 0, quarter], [0, 0, quarter]]))
    estimated = poses_at(np.array([[9.0, 9, 9], [13, 6, 9]]), np.array([[0, 0, 0], [0, 0, np.pi / 3]]))
    off_m, off_deg = relative_errors(estimated, true, *pairs(true, Delta(1, "frames")))
    assert off_m == pytest.approx([3.0])
    assert off_deg == pytest.approx([60.0])


def test_small_angles_are_exact():
    true = straight(2, 1.0)
    estimated = poses_at(true[:, :3, 3], np.array([[0, 0, 0], [0, 0, 1e-9]]))
    _, off_deg = relative_errors(estimated, true, *pairs(true, Delta(1, "frames")))
    assert off_deg == pytest.approx([np.degrees(1e-9)], rel=1e-6)


def test_pairs_of_frames():
    first, second = pairs(straight(5, 1.0), Delta(3, "frames"))
    assert (first.tolist(), second.tolist()) == ([0, 1], [3, 4])
    assert [len(part) for part in pairs(straight(5, 1.0), Delta(5, "frames"))] == [0, 0]


def test_pairs_of_metres_by_hand():
    """At 0, 0.5, 1.04, 1.04, 2.2 and 3.3 m: from 0.5 m on 1.04 and 2.2 are too far off 1 m."""
    path = poses_at(np.outer([0.0, 0.5, 1.04, 1.04, 2.2, 3.3], [0, 1.0, 0]))
    first, second = pairs(path, Delta(1.0, "metres"))
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == [(0, 2), (4, 5)]


@settings(max_examples=200)
@given(
    steps_m=st.lists(st.one_of(st.just(0.0), st.floats(0.001, 3.0)), min_size=1, max_size=40),
    length_m=st.floats(0.01, 10.0),
)
def test_pairs_of_metres_are_those_of_a_plain_search(steps_m, length_m):
    path = poses_at(np.outer(np.concatenate(([0.0], np.cumsum(steps_m))), [1.0, 0, 0]))
    driven_m = path_m(path)
    expected = []
    for i in range(len(driven_m) - 1):
        off_m = np.abs(driven_m[i + 1 :] - driven_m[i] - length_m)
        if off_m.min() <= 0.1 * length_m:
            expected.append((i, i + 1 + int(np.argmin(off_m))))
    first, second = pairs(path, Delta(length_m, "metres"))
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == expected


def test_kittis_errors_of_a_path_too_long_by_a_tenth():
    """Steps of 1 m; a stretch of 10 m ends at the first pose beyond, after 11 m, and is wrong by 1.1 m."""
    true = straight(40, 1.0)
    percent, deg = segment_errors(scaled(true, 1.1), true, 10.0, 10)
    np.testing.assert_allclose(percent, [11.0, 11.0, 11.0])
    np.testing.assert_allclose(deg, 0.0)


def test_kittis_errors_of_a_path_that_bends():
    """A tenth of a degree a metre is 10 degrees in 100 m, for stretches that reach 101 m."""
    true = straight(250, 1.0)
    rotvecs = np.outer(np.deg2rad(0.1) * np.arange(250), [0, 0, 1.0])
    estimated = poses_at(true[:, :3, 3], rotvecs)
    _, deg = segment_errors(estimated, true, 100.0, 10)
    assert len(deg) == 15
    np.testing.assert_allclose(deg, 10.1)


def test_no_stretch_fits_into_a_short_path():
    assert [len(part) for part in segment_errors(straight(11, 1.0), straight(11, 1.0), 10.0, 1)] == [0, 0]


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_rigid_motion_of_either_path_changes_what_is_relative(seed):
    true = helix(60)
    estimated = noisy(true, 3)
    here, there = pairs(estimated, Delta(4.0, "metres")), pairs(rigid(seed) @ estimated, Delta(4.0, "metres"))
    np.testing.assert_array_equal(here, there)
    before = relative_errors(estimated, true, *here)
    after = relative_errors(rigid(seed) @ estimated, rigid(seed + 1) @ true, *there)
    np.testing.assert_allclose(after, before, atol=1e-9)
