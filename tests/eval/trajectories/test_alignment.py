"""Alignments: what each of them takes away, and what it leaves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.errors import TableError
from roadperc_stream.eval.trajectories.alignment import align, umeyama
from roadperc_stream.eval.trajectories.errors import absolute_errors_m
from tests.eval.trajectories.paths import helix, noisy, poses_at, rigid, scaled, straight

TRUE = helix(80)


def rmse_m(estimated, true, how):
    errors = absolute_errors_m(align(estimated, true, how).poses(estimated), true)
    return float(np.sqrt(np.mean(errors**2)))


@pytest.mark.parametrize("how", ["se3", "sim3", "origin", "none"])
def test_a_path_lies_on_itself(how):
    found = align(TRUE, TRUE, how)
    np.testing.assert_allclose(found.poses(TRUE), TRUE, atol=1e-12)
    assert found.scale == pytest.approx(1.0, abs=1e-14)


def test_se3_undoes_a_turn_and_a_shift():
    moved = rigid(1) @ TRUE
    np.testing.assert_allclose(align(moved, TRUE, "se3").poses(moved), TRUE, atol=1e-11)
    np.testing.assert_allclose(align(moved, TRUE, "origin").poses(moved), TRUE, atol=1e-11)
    assert rmse_m(moved, TRUE, "none") > 1


def test_sim3_alone_undoes_a_scale():
    grown = scaled(TRUE, 2.5)
    found = align(grown, TRUE, "sim3")
    assert found.scale == pytest.approx(0.4, rel=1e-12)
    np.testing.assert_allclose(found.poses(grown), TRUE, atol=1e-11)
    assert all(rmse_m(grown, TRUE, how) > 1 for how in ("se3", "origin", "none"))


def test_the_axes_are_turned_and_never_scaled():
    turned = align(rigid(2) @ scaled(TRUE, 3.0), TRUE, "sim3").poses(rigid(2) @ scaled(TRUE, 3.0))
    np.testing.assert_allclose(np.linalg.det(turned[:, :3, :3]), 1.0, atol=1e-12)
    np.testing.assert_array_equal(turned[:, 3], np.tile([0.0, 0, 0, 1], (len(TRUE), 1)))


def test_a_mirrored_path_is_not_mirrored_back():
    mirrored = TRUE.copy()
    mirrored[:, 2, 3] *= -1
    assert np.linalg.det(align(mirrored, TRUE, "se3").rotation) == pytest.approx(1.0)
    assert rmse_m(mirrored, TRUE, "se3") > 0.05


def test_known_scale_of_two_triangles():
    """3-4-5 and 6-8-10: the scale is two, both ways."""
    small = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]])
    assert umeyama(small, 2 * small, with_scale=True).scale == pytest.approx(2.0, rel=1e-12)
    assert umeyama(2 * small, small, with_scale=True).scale == pytest.approx(0.5, rel=1e-12)
    shifted = umeyama(small, 2 * small, with_scale=False).points(small)
    np.testing.assert_allclose(shifted - small, np.tile([2, 4 / 3, 0], (3, 1)), atol=1e-12)


def test_the_scale_is_the_one_of_least_squares():
    """What scatters across a path stretches no other: they have 2 m2 in common, of 2 m2 and of 8 m2."""
    line = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    bumpy = np.array([[-1.0, 1, 0], [0, -2, 0], [1, 1, 0]])
    assert umeyama(line, bumpy, with_scale=True).scale == pytest.approx(1.0, rel=1e-12)
    assert umeyama(bumpy, line, with_scale=True).scale == pytest.approx(1 / 4, rel=1e-12)


@pytest.mark.parametrize("how", ["se3", "sim3"])
def test_a_straight_road_leaves_a_turn_free_and_no_distance(how):
    line = straight(20, 0.5)
    assert rmse_m(rigid(3) @ line, line, how) < 1e-12


def test_standing_still_is_aligned_but_has_no_scale():
    standing = straight(10, 0.0)
    assert rmse_m(rigid(4) @ standing, standing, "se3") < 1e-12
    for estimated, true in ((standing, TRUE[:10]), (TRUE[:10], standing), (standing, standing)):
        with pytest.raises(TableError, match=r"no Sim\(3\) alignment: one of the paths stands still"):
            align(estimated, true, "sim3")


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), how=st.sampled_from(["se3", "sim3"]))
def test_no_rigid_motion_of_the_estimate_changes_what_is_left(seed, how):
    estimated = noisy(TRUE, 7)
    moved = rigid(seed) @ estimated
    assert rmse_m(moved, TRUE, how) == pytest.approx(rmse_m(estimated, TRUE, how), rel=1e-9)


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 100))
def test_no_scale_of_the_estimate_changes_what_sim3_leaves(seed, scale):
    estimated = noisy(TRUE, seed)
    assert rmse_m(scaled(estimated, scale), TRUE, "sim3") == pytest.approx(rmse_m(estimated, TRUE, "sim3"), rel=1e-8)


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_more_freedom_never_leaves_more(seed):
    estimated = rigid(seed) @ noisy(TRUE, seed)
    left = [rmse_m(estimated, TRUE, how) for how in ("sim3", "se3", "origin")]
    assert left == sorted(left)


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_small_turn_makes_it_better(seed):
    """The best turn is a best one: any other nearby leaves more."""
    estimated = noisy(TRUE, 5)
    best = align(estimated, TRUE, "se3").poses(estimated)
    centre = best[:, :3, 3].mean(axis=0)
    rotvec = np.random.default_rng(seed).normal(0, 1e-3, (1, 3))
    turn = poses_at(np.zeros((1, 3)), rotvec)[0]
    turned = (best[:, :3, 3] - centre) @ turn[:3, :3].T + centre
    assert np.sum((turned - TRUE[:, :3, 3]) ** 2) > np.sum((best[:, :3, 3] - TRUE[:, :3, 3]) ** 2)
