"""The road's plane: known planes, outliers, planes that cannot be a road, and roads that leave their plane."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.surface.plane import leaves_plane, median
from roadperc_stream.chain.stages.surface.road import assumed_surface, drivable_mask, fit_surface
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.model import Absent, Reason
from tests.analytic import LINE, ROAD, Road
from tests.hills import Hill
from tests.scenes import scene_of

CFG = SurfaceConfig()


def fit(road, depth_m, mask, cfg=CFG, seed=0):
    frame = scene_of(road.camera, road.ego_T_camera, depth_m=depth_m)
    return fit_surface(cfg, frame, mask, np.random.default_rng(seed))


@settings(max_examples=15)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0.8, 3.0))
def test_recovers_any_plane(pitch, roll, height_m):
    road = Road(pitch=pitch, roll=roll, height_m=height_m, width=320, height=240)
    surface = fit(road, road.depth_m(), road.tags() == ROAD)
    assert surface.camera_height_m == pytest.approx(height_m, abs=1e-3)
    assert (surface.pitch, surface.roll) == pytest.approx((pitch, roll), abs=2e-4)
    assert surface.inlier_ratio > 0.999
    assert surface.abd == pytest.approx((0, 0, 0), abs=2e-3)


def test_a_third_of_outliers_does_not_move_the_plane():
    road = Road()
    depth = road.depth_m()
    rng = np.random.default_rng(1)
    wild = rng.random(depth.shape) < 1 / 3
    depth[wild] *= rng.uniform(0.2, 0.9, wild.sum()).astype(np.float32)
    surface = fit(road, depth, road.tags() == ROAD)
    assert surface.camera_height_m == pytest.approx(1.4, abs=1e-3)
    assert np.degrees(g.angle_between(surface.plane.n, road.plane.n)) < 0.01
    assert 0.6 < surface.inlier_ratio < 0.75


def test_the_search_keeps_its_points_and_the_best_hypotheses():
    """In the ego frame the road is z = 0; a plane through three of its points has nearly all others."""
    road = Road()
    depth = road.depth_m()
    depth[np.random.default_rng(1).random(depth.shape) < 1 / 3] *= np.float32(0.5)
    search = fit(road, depth, road.tags() == ROAD).search
    on_road = np.abs(search.points[:, 2]) < search.inlier_m
    assert on_road.mean() == pytest.approx(2 / 3, abs=0.03)
    assert search.shares[0] == pytest.approx(on_road.mean(), abs=0.01)
    assert (np.diff(search.shares) <= 0).all()
    assert np.abs(search.triples[0, :, 2]).max() < search.inlier_m
    assert len(search.triples) == 32 <= search.compared <= CFG.hypotheses


def test_noise_averages_out():
    road = Road()
    depth = road.depth_m() * np.random.default_rng(2).normal(1, 0.01, (480, 640)).astype(np.float32)
    surface = fit(road, depth, road.tags() == ROAD)
    assert np.degrees(g.angle_between(surface.plane.n, road.plane.n)) < 0.05


def test_depth_of_the_published_plane_of_course_frame_0_gives_the_plane_back(data_dir):
    """To 0.01 degrees and 1 mm, with a third of outliers (the course counts pixels from 1)."""
    expected = json.loads((data_dir / "course_frames" / "expected.json").read_text())["0"]
    a, b, c, d = expected["plane_abcd"]
    camera = g.Camera("camera", 1280, 960, 640.0, 640.0, 639.0, 479.0)
    plane = g.facing(g.Plane.of(np.array([a, b, c]), d), np.zeros(3))
    tags = np.loadtxt(data_dir / "course_frames" / "segmentation" / "0.dat", delimiter=",").astype(np.uint8)
    road = tags == ROAD
    assert road.sum() == expected["road_pixels"]
    rows, columns = np.indices(tags.shape, dtype=float)
    depth = g.intersect_plane(camera, np.stack((columns, rows), axis=-1), plane)[..., 2].astype(np.float32)
    assert depth[799, 799] == pytest.approx(expected["depth_m_at_800_800"], abs=0.02)
    rng = np.random.default_rng(0)
    wild = rng.random(depth.shape) < 1 / 3
    depth[wild] = rng.uniform(1, 60, wild.sum()).astype(np.float32)
    frame = scene_of(camera, g.mounting(z=1.4), depth_m=depth)
    surface = fit_surface(CFG, frame, road, np.random.default_rng(0))
    assert np.degrees(g.angle_between(surface.plane.n, plane.n)) < 0.01
    assert surface.camera_height_m == pytest.approx(plane.offset_m, abs=1e-3)


def test_the_assumed_surface_has_the_mountings_pitch():
    road = Road(pitch=0.05)
    surface = assumed_surface(road.camera, road.ego_T_camera)
    assert (surface.source, surface.inlier_ratio) == ("assumed", None)
    assert surface.pitch == pytest.approx(0.05)


def test_a_plane_above_the_camera_is_not_a_road():
    """For example a ceiling with wrong tags: it is level, but faces down."""
    road = Road(width=320, height=240)
    above = np.flipud(road.tags() == ROAD)
    found = fit(road, np.ascontiguousarray(np.flipud(road.depth_m())), above)
    assert found.reason.code == "plane_tilted"
    assert found.reason.values[0] > 170


@pytest.mark.parametrize("first", [0, 1])
def test_depth_with_regular_holes_gives_the_plane(first):
    """Depth that is projected into a wider image is known in every second column only."""
    road = Road(width=960, height=720)
    depth = np.full((720, 960), np.nan, np.float32)
    depth[:, first::2] = road.depth_m()[:, first::2]
    surface = fit(road, depth, road.tags() == ROAD)
    assert surface.camera_height_m == pytest.approx(1.4, abs=1e-3)


@pytest.mark.parametrize(
    ("mask", "depth", "count"),
    [
        (np.zeros((480, 640), bool), np.full((480, 640), 5.0, np.float32), 0),
        (np.ones((480, 640), bool), np.full((480, 640), np.nan, np.float32), 0),
        (np.eye(480, 640, dtype=bool) & (np.arange(480) == 400)[:, None], np.full((480, 640), 5.0, np.float32), 1),
        (np.ones((480, 640), bool), np.full((480, 640), CFG.max_depth_m, np.float32), 0),
    ],
    ids=["no road", "all depth unknown", "one point", "too far"],
)
def test_too_few_points_are_absent_with_their_number(mask, depth, count):
    assert fit(Road(), depth, mask) == Absent(Reason("surface", "too_few_road_points", (count,)))


def test_three_collinear_points_give_no_surface():
    mask = np.zeros((480, 640), bool)
    mask[400, [100, 200, 300]] = True
    assert isinstance(fit(Road(), np.full((480, 640), 5.0, np.float32), mask), Absent)


def test_drivable_pixels_are_near_the_plane_and_of_a_class():
    road = Road()
    depth, tags = road.depth_m(), road.tags()
    surface = fit(road, depth, tags == ROAD)
    depth = depth.copy()
    depth[400, 300:310] *= 0.7
    scene = scene_of(
        road.camera, road.ego_T_camera, depth_m=depth, tags=np.where(tags == ROAD, ROAD, 0).astype(np.uint8)
    )
    mask = drivable_mask(CFG, scene, surface)
    known = (tags == ROAD) & np.isfinite(depth)
    known[400, 300:310] = False
    np.testing.assert_array_equal(mask, known)


def test_drivable_without_depth_or_tags():
    road = Road()
    tags = np.where(road.tags() == ROAD, ROAD, 0).astype(np.uint8)
    place, surface = (road.camera, road.ego_T_camera), assumed_surface(road.camera, road.ego_T_camera)
    np.testing.assert_array_equal(drivable_mask(CFG, scene_of(*place, tags=tags), surface), tags == ROAD)
    nothing = Reason("drivable", "no_depth_no_segmentation")
    assert drivable_mask(CFG, scene_of(*place), surface) == Absent(nothing)
    no_plane = Reason("surface", "plane_without_points")
    no_surface = drivable_mask(CFG, scene_of(*place, tags=tags, depth_m=road.depth_m()), Absent(no_plane))
    assert no_surface == Absent(Reason("drivable", "no_surface", cause=no_plane))


@pytest.mark.parametrize("seed", range(3))
def test_points_closer_together_than_inlier_m_give_no_upright_plane(seed):
    """They are inliers of a level hypothesis, but the fit to all of them is upright."""
    road = Road(width=320, height=240)
    depth = np.random.default_rng(seed).normal(0.01, 0.001, road.camera.size).astype(np.float32)
    found = fit(road, depth, None, seed=seed)
    assert isinstance(found, Absent)
    assert re.fullmatch(r"the points' plane is tilted by [5-9]\d degrees, expected at most 30", found.reason.text)


@pytest.mark.parametrize("scale", [1e-30, 1e-42])
def test_points_all_in_one_place_give_no_plane(scale):
    """For example those of a stereo pair without a baseline: any plane fits, and an upright one has no height."""
    road = Road(width=320, height=240)
    found = fit(road, (road.depth_m() * scale).astype(np.float32), None)
    assert isinstance(found, Absent)
    assert found.reason.code == "no_plane"


FLAT = Hill(width=320, height=240, grade=0.0)


def flat(at):
    return np.zeros(len(at))


def cells(height=flat, std=0.0, seed=0, ahead_m=0.0):
    """A cell for each square metre, 50 m ahead and 6 m to either side; heights have normal errors."""
    at = np.stack(np.meshgrid(ahead_m + np.arange(0.5, 50), np.arange(-5.5, 6)), axis=-1).reshape(-1, 2)
    return np.column_stack((at, height(at) + np.random.default_rng(seed).normal(0, std, len(at))))


@pytest.mark.parametrize("std", [0.0, 0.01, 0.1])
def test_noise_alone_does_not_leave_the_plane(std):
    assert sum(leaves_plane(cells(std=std, seed=seed)) for seed in range(20)) <= 2


@pytest.mark.parametrize(
    ("height", "std"),
    [
        (lambda at: 0.001 * (at[:, 0] - 20) ** 2 - 0.1, 0.01),
        (lambda at: 0.004 * at[:, 0] - 0.06, 0.01),
        (lambda at: 0.02 * np.sign(at[:, 1]), 0.01),
        (lambda at: 0.004 * np.sin(at[:, 0] / 8), 0.001),
    ],
    ids=["crest", "tilted plane", "crown", "waves above the noise"],
)
def test_a_road_that_leaves_its_plane_is_detected(height, std):
    assert leaves_plane(cells(height, std))
    assert leaves_plane(cells(height))


@pytest.mark.parametrize(
    "points",
    [
        cells(lambda at: 0.004 * np.sin(at[:, 0] / 8), 0.05),
        cells(lambda at: 0.2 * ((at[:, 0] > 20) & (at[:, 0] < 24)), 0.01),
        cells(lambda at: 0.15 * (at[:, 1] > 3), 0.005),
        np.empty((0, 3)),
        cells()[:4],
        cells(lambda at: 0.1 * at[:, 0], ahead_m=60.0),
    ],
    ids=["waves below the noise", "one bump", "a few cells on a kerb", "no cells", "four cells", "far ahead"],
)
def test_a_road_that_does_not_leave_its_plane_is_not_reported(points):
    assert not leaves_plane(points)


@pytest.mark.parametrize(("grade", "model"), [(0.0, "plane"), (0.08, "spline"), (-0.05, "spline")])
def test_auto_chooses_the_model_by_the_road(grade, model):
    hill = replace(FLAT, grade=grade)
    depth_m = hill.depth_m() * np.random.default_rng(1).normal(1, 0.01, hill.depth_m().shape).astype(np.float32)
    road = np.isin(hill.tags(), (ROAD, LINE))
    auto, chosen = (fit(hill, depth_m, road, SurfaceConfig(model=name)) for name in ("auto", model))
    assert auto.model == model
    assert auto.plane == chosen.plane
    assert (auto.height_grid is None) == (model == "plane")
    if auto.height_grid is not None:
        assert np.array_equal(auto.height_grid.z_m, chosen.height_grid.z_m)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_the_median_is_numpys(values):
    assert median(np.array(values)) == np.median(values)
