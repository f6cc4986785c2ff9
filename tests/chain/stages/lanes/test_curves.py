"""Curves from edge points with known answers."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.lanes import curves
from roadperc_stream.config import LanesConfig

CFG = LanesConfig()
PX = 1 / 640


def points(state, step_m=0.1, reach_m=35.0):
    x = np.arange(3.0, reach_m, step_m)
    return np.stack((x, curves.lateral(np.array(state), x)), axis=-1)


def fit(cloud, line, side="left", rows=None):
    rows = np.arange(len(cloud), dtype=float) if rows is None else rows
    return curves.fit_curve(CFG, curves.Edges.of(cloud, rows), np.array(line), side, PX)


def test_exact_points_give_the_curve_back():
    curve = fit(points((1.7, 0.02, 1 / 150)), (1.68, 0.03, 0.0))
    np.testing.assert_allclose(curve.state, (1.7, 0.02, 1 / 150), atol=1e-3)
    assert curve.reach_m == pytest.approx(34.9, abs=0.2)


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_the_inner_edge_of_a_double_line_is_chosen(side, sign):
    """The edge of the second line, 25 cm farther out, also faces the ego lane and has the same support."""
    inner, outer = points((sign * 1.6, 0.0, 0.004)), points((sign * 1.85, 0.0, 0.004))
    rows = np.tile(np.arange(len(inner), dtype=float), 2)
    curve = fit(np.concatenate((outer, inner)), (sign * 1.85, 0.0, 0.0), side, rows)
    assert curve.state[0] == pytest.approx(sign * 1.6, abs=0.01)
    assert curves.lateral(curve.state, 20.0) == pytest.approx(sign * 1.6 + 0.8, abs=0.02)


def test_salt_in_a_fifth_of_the_rows_is_outvoted():
    rng = np.random.default_rng(0)
    cloud = points((1.7, 0.0, 0.0))
    salted = rng.random(len(cloud)) < 0.2
    cloud[salted, 1] -= rng.uniform(0, 0.3, salted.sum())
    assert fit(cloud, (1.7, 0.0, 0.0)).state[0] == pytest.approx(1.7, abs=0.03)


def test_covariance_holds_the_error():
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(40):
        cloud = points((1.7, 0.0, 0.0))
        cloud[:, 1] += rng.normal(0, 0.01 + PX * cloud[:, 0])
        curve = fit(cloud, (1.7, 0.0, 0.0))
        error = curve.state - (1.7, 0.0, 0.0)
        errors.append(error @ np.linalg.solve(curve.covariance, error))
    assert np.mean(errors) < 3.0


def test_a_camera_of_few_pixels_gives_no_error():
    """At the highest noise, a pixel is wider than the search strip."""
    x, y = points((1.7, 0.0, 0.0)).T
    aside_m = curves._best_aside(x, y, np.array([1.7, 0.0, 0.0]), -1.0, curves._Noise(16.0, 1 / 20))
    assert abs(aside_m) < curves._SEARCH_M


def test_edges_of_a_single_row_are_not_a_curve():
    """A tag error may be a dotted row, a metre wide, with all points at the same distance ahead."""
    aside = np.linspace(1.2, 2.2, 40)
    row = np.stack((np.full_like(aside, 4.0), aside), axis=-1)
    assert fit(row, (1.7, 0.0, 0.0), rows=np.full(len(row), 300.0)) is None


def test_too_few_or_too_far_edges_are_not_a_curve():
    assert fit(points((1.7, 0, 0))[:5], (1.7, 0, 0)) is None
    far = points((1.7, 0, 0), reach_m=39.0)
    assert fit(far[far[:, 0] > 16], (1.7, 0, 0)) is None


def test_line_on_ground_of_a_straight_line():
    cloud = np.concatenate((points((1.7, 0.1, 0.0)), np.zeros((320, 1))), axis=1)
    np.testing.assert_allclose(curves.line_on_ground(cloud), (1.7, 0.1, 0.0), atol=1e-9)
    assert curves.line_on_ground(cloud[:1]) is None


def test_without_information_the_curvature_has_its_prior():
    """Edges from 4 m to 9 m do not show a curvature; the prior has a standard deviation of 0.01 / m."""
    near, far = points((1.7, 0.0, 0.0), reach_m=7.0), points((1.7, 0.0, 0.0), reach_m=60.0)
    unknown, known = (np.sqrt(fit(cloud, (1.7, 0.0, 0.0)).covariance[2, 2]) for cloud in (near, far))
    assert 0.008 < unknown < 0.01
    assert known < 0.001


def test_a_changing_curvature_draws_the_fit_as_told():
    """Edges on y = 1.7 + c x^3 / 6 are fitted by a quadratic that is off by about ``drawn`` c."""
    slope_per_m2 = 1e-5
    cloud = points((1.7, 0.0, 0.0))
    cloud[:, 1] += slope_per_m2 * cloud[:, 0] ** 3 / 6
    curve = fit(cloud, (1.7, 0.0, 0.0))
    np.testing.assert_allclose(curve.state - [1.7, 0.0, 0.0], curve.per_slope * slope_per_m2, rtol=0.15)


def test_rows_are_counted_once_and_only_beside_the_line():
    """Of six edges two are in one row, one is far inside, and one unknown or beyond the reach."""
    inside_m, rows = np.array([0.1, 0.2, -0.1, 0.9, np.nan, 0.1]), np.array([3, 3, 4, 5, 6, 7])
    assert [curves._rows_near(inside_m, rows, line_m, 0.3) for line_m in (0.0, 1.0, 2.0)] == [3, 1, 0]


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
@pytest.mark.parametrize(("reach_m", "rows_on_it"), [(4.5, 2), (5.0, 3), (0.5, 0)])
def test_only_rows_beside_the_curve_and_within_its_reach_support_it(side, sign, reach_m, rows_on_it):
    """Of six edges two are in one row, one is far inside, and one unknown; the last is at 5 m."""
    x, inside_m = np.array([1.0, 1.0, 2.0, 3.0, 4.0, 5.0]), np.array([0.1, 0.2, -0.1, 0.9, np.nan, 0.1])
    state = sign * np.array([1.7, 0.02, 1 / 150])
    edges = curves.Edges(x, curves.lateral(state, x) - sign * inside_m, np.array([3, 3, 4, 5, 6, 7]))
    found, _ = curves._support(curves.Curve(state, np.eye(3), reach_m), edges, np.full(6, 0.1), side)
    assert found == (rows_on_it / max(rows_on_it, 1))
