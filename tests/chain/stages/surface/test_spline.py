"""The height field: known hills, noise, outliers, gaps in the data, and the drivable pixels."""

from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.lanes import ego_lane
from roadperc_stream.chain.stages.lanes.tracking import LanesState
from roadperc_stream.chain.stages.surface import spline
from roadperc_stream.chain.stages.surface.road import drivable_mask, fit_surface
from roadperc_stream.chain.stages.surface.spline import DEGREE, basis
from roadperc_stream.config import LanesConfig, SurfaceConfig
from roadperc_stream.geometry.ground import height_at
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.metrics.surface import surface_height_error_m
from tests.analytic import LINE, ROAD
from tests.hills import Hill
from tests.scenes import scene_of

CFG = SurfaceConfig(model="spline")
HILL = Hill(width=320, height=240)


def road_of(hill):
    return np.isin(hill.tags(), (ROAD, LINE))


def fit(hill, depth_m=None, mask=None, cfg=CFG):
    depth_m = hill.depth_m() if depth_m is None else depth_m
    mask = road_of(hill) if mask is None else mask
    return fit_surface(cfg, depth_of(hill, depth_m), mask, np.random.default_rng(0))


def depth_of(hill, depth_m, ego_T_camera=None):
    mounting = hill.ego_T_camera if ego_T_camera is None else ego_T_camera
    return scene_of(hill.camera, mounting, depth_m=depth_m)


def drivable(hill, surface, depth_m, road):
    """The drivable pixels if only (H, W) ``road`` has a drivable class; None means no segmentation."""
    tags = None if road is None else np.where(road, ROAD, 0).astype(np.uint8)
    return drivable_mask(CFG, scene_of(hill.camera, hill.ego_T_camera, depth_m=depth_m, tags=tags), surface)


def noisy(depth_m, std=0.01):
    return depth_m * np.random.default_rng(1).normal(1, std, depth_m.shape).astype(np.float32)


def second_differences(surface):
    """The second differences of the height along the middle of the road."""
    x = np.arange(61.0)
    return np.diff(height_at(surface, x, np.zeros_like(x)), 2)


@settings(max_examples=4)
@given(st.floats(-0.1, 0.1), st.floats(-0.04, 0.04), st.floats(-0.04, 0.04), st.floats(-0.03, 0.03))
def test_recovers_any_gentle_hill(grade, bank, pitch, roll):
    hill = replace(HILL, grade=grade, bank=bank, pitch=pitch, roll=roll)
    surface = fit(hill)
    assert surface.model == "spline"
    assert surface_height_error_m(surface, hill.surface()) < 0.01


@pytest.mark.parametrize("grade", [0.08, -0.08])
def test_with_noise_the_field_has_at_most_a_third_of_the_planes_error(grade):
    hill = replace(HILL, grade=grade)
    depth_m = noisy(hill.depth_m())
    field, plane = (fit(hill, depth_m, cfg=SurfaceConfig(model=model)) for model in ("spline", "plane"))
    assert replace(field, model="plane", height_grid=None) == plane
    assert surface_height_error_m(field, hill.surface()) < 0.02
    assert surface_height_error_m(field, hill.surface()) < surface_height_error_m(plane, hill.surface()) / 3


def test_cars_with_road_tags_do_not_bend_it():
    depth_m, mask = HILL.depth_m(), road_of(HILL)
    for rows, columns, distance_m in (
        (slice(115, 150), slice(130, 165), 7.0),
        (slice(112, 124), slice(166, 178), 18.0),
    ):
        depth_m[rows, columns] = np.fmin(depth_m[rows, columns], distance_m)
        mask[rows, columns] = True
    assert surface_height_error_m(fit(HILL, depth_m, mask), HILL.surface()) < 0.02


def test_beyond_the_data_it_continues_straight():
    depth_m = noisy(HILL.depth_m())
    depth_m[~(depth_m < 22)] = np.nan
    bends = second_differences(fit(HILL, depth_m))
    np.testing.assert_allclose(bends[35:], 0, atol=1e-4)
    assert np.abs(bends).max() < 0.01


def test_a_wall_with_road_tags_behind_a_gap_in_the_data_does_not_bend_it():
    depth_m, mask = HILL.depth_m(), road_of(HILL)
    depth_m[~(depth_m < 22)] = np.nan
    depth_m[60:90, 100:220], mask[60:90, 100:220] = np.linspace(40, 55, 120, dtype=np.float32), True
    surface = fit(HILL, depth_m, mask)
    x = np.arange(5.0, 23.0)
    np.testing.assert_allclose(height_at(surface, x, np.zeros_like(x)), HILL.z(x, 0.0), atol=0.02)
    x = np.arange(30.0, 61.0)
    assert np.abs(height_at(surface, x, np.zeros_like(x)) - HILL.z(x, 0.0)).max() < 2.0


def test_a_road_that_bends_behind_a_gap_is_found_again():
    """Depth is unknown from 12 m to 26 m; behind the gap the road is 0.5 m above a straight continuation."""
    hill = replace(HILL, grade=0.1, wave_m=120.0)
    depth_m = hill.depth_m()
    depth_m[(depth_m > 12) & (depth_m < 26)] = np.nan
    surface = fit(hill, depth_m)
    x = np.arange(27.0, 45.0)
    np.testing.assert_allclose(height_at(surface, x, np.zeros_like(x)), hill.z(x, 0.0), atol=0.05)


def test_noise_causes_no_waves():
    assert np.abs(second_differences(fit(HILL, noisy(HILL.depth_m(), 0.03)))).max() < 0.01


def test_a_short_stretch_and_a_camera_that_looks_back_give_a_plane():
    for farthest_m in (4.0, 8.0):
        depth_m = HILL.depth_m()
        depth_m[~(depth_m < farthest_m)] = np.nan
        surface = fit(HILL, depth_m)
        assert (surface.model, surface.height_grid) == ("plane", None)
    back = g.rigid(rotation_from_rpy(0, 0, np.pi), np.zeros(3)) @ HILL.ego_T_camera
    surface = fit_surface(CFG, depth_of(HILL, HILL.depth_m(), back), road_of(HILL), np.random.default_rng(0))
    assert surface.model == "plane"


def test_without_segmentation_the_lower_image_gives_a_field_too():
    surface = fit_surface(CFG, depth_of(HILL, HILL.depth_m()), None, np.random.default_rng(0))
    assert (surface.source, surface.model) == ("lower_image", "plane")
    high = replace(HILL, pitch=-0.2)
    surface = fit_surface(CFG, depth_of(high, high.depth_m()), None, np.random.default_rng(0))
    assert (surface.source, surface.model) == ("lower_image", "spline")


def test_a_very_large_max_depth_costs_neither_time_nor_memory():
    """The field ends at 200 m, because heights are not looked up beyond."""
    depth_m, usual = HILL.depth_m(), height_at(fit(HILL), *np.meshgrid(np.arange(40.0), np.arange(-5.0, 6.0)))
    started = process_time()
    surface = fit(HILL, depth_m, cfg=CFG.model_copy(update={"spline_knot_m": 1.0, "max_depth_m": 1e4}))
    assert process_time() - started < 2.0
    assert surface.height_grid.z_m.shape == (21, 201)
    heights = height_at(surface, *np.meshgrid(np.arange(40.0), np.arange(-5.0, 6.0)))
    np.testing.assert_allclose(heights, usual, atol=0.02)


def information(coefficients):
    """The squared deviation of coefficients from the prior, in its standard deviations."""
    count = len(coefficients)
    below = sum(np.diag(diagonal[: count - k], -k) for k, diagonal in enumerate(spline._prior(CFG)))
    return coefficients @ (below + np.tril(below, -1).T) @ coefficients


def test_the_prior_has_the_standard_deviations_of_curvature_and_bank():
    count = spline._splines(CFG)
    heights = CFG.spline_curvature_per_m * (CFG.spline_knot_m * np.arange(count)) ** 2 / 2
    leaning = np.full(count, spline._BANK_STD * CFG.spline_half_width_m)
    nothing = np.zeros(count)
    assert information(np.stack((heights, nothing), -1).ravel()) == pytest.approx(count - 2)
    assert information(np.stack((heights * 2, nothing), -1).ravel()) == pytest.approx(4 * (count - 2))
    assert information(np.stack((nothing, leaning), -1).ravel()) == pytest.approx(count)
    assert information(np.stack((nothing, heights), -1).ravel()) > count - 2


def test_drivable_pixels_are_near_the_field():
    hill = replace(HILL, grade=0.1, wave_m=120.0)
    depth_m, road = hill.depth_m(), road_of(hill)
    surface = fit(hill, depth_m, road)
    classes = road.astype(np.uint8)
    classes[:3] = 1
    raised = depth_m.copy()
    raised[200, 150:160] *= 0.7
    mask = drivable(hill, surface, raised, classes)
    known = road & (depth_m < 50)
    known[200, 150:160] = False
    assert mask[known].all()
    assert not mask[200, 150:160].any()
    assert not mask[:3].any()
    assert not mask[~classes.view(bool)].any()
    level = replace(surface, model="plane", height_grid=None)
    plane = drivable(hill, level, raised, classes)
    assert np.count_nonzero(plane[depth_m > 20]) < 0.1 * np.count_nonzero(mask[depth_m > 20])

    assert drivable(hill, surface, depth_m, None)[depth_m < 40].mean() > 0.99
    assert not drivable(hill, surface, depth_m, np.zeros(depth_m.shape, np.uint8)).any()


def test_straight_lanes_over_a_hill_are_measured_as_straight():
    hill = Hill(left_m=1.8, right_m=-1.9)
    surface = fit(hill)
    road = drivable(hill, surface, hill.depth_m(), road_of(hill))
    found = {}
    for model in (surface, replace(surface, model="plane", height_grid=None)):
        scene = scene_of(hill.camera, hill.ego_T_camera, tags=hill.tags())
        left = ego_lane.step(LanesConfig(), LanesState(), scene, model, road, None)[1].side("left")
        x = left.offset_m + 30 * left.heading + 450 * left.curvature_per_m
        found[model.model] = abs(x - 1.8)
        if model is surface:
            points = left.line_ego_m
            np.testing.assert_allclose(points[:, 2], hill.z(points[:, 0], points[:, 1]), atol=0.02)
    assert found["spline"] < 0.1
    assert found["spline"] < found["plane"] / 3


@pytest.mark.parametrize(("knot_m", "splines"), [(5.0, 15), (1.0, 4), (0.3, 60)])
def test_the_basis_has_scipys_values(knot_m, splines):
    length = knot_m * (splines - DEGREE)
    x = np.concatenate((np.random.default_rng(0).uniform(0, length, 200), knot_m * np.arange(splines - DEGREE + 1)))
    x = np.minimum(x, knot_m * np.arange(splines + 1)[-1 - DEGREE])
    knots = knot_m * np.arange(-DEGREE, splines + 1)
    expected = BSpline.design_matrix(x, knots, DEGREE).toarray()
    first, values = basis(knot_m, splines, x)
    found = np.zeros_like(expected)
    np.put_along_axis(found, first[:, None] + np.arange(DEGREE + 1), values, axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-12)


def test_singular_equations_keep_the_earlier_coefficients():
    design = spline._design(CFG, np.array([5.0]), np.array([0.0]))
    no_prior = np.zeros_like(spline._prior(CFG))
    earlier = np.arange(float(no_prior.shape[1]))
    np.testing.assert_array_equal(spline._robust_fit(design, np.zeros(1), np.ones(1), no_prior, earlier), earlier)
