"""Plane or height field, by the evidence of the road's cells."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.stages.surface.plane import leaves_plane, median
from roadperc_stream.chain.stages.surface.road import fit_surface
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.model.scene import DepthMap
from tests.analytic import LINE, ROAD
from tests.hills import Hill

FLAT = Hill(width=320, height=240, grade=0.0)


def flat(at):
    return np.zeros(len(at))


def cells(height=flat, std=0.0, seed=0, ahead_m=0.0):
    """A cell for each square metre, 50 m ahead and 6 m to either side, its height with normal errors."""
    at = np.stack(np.meshgrid(ahead_m + np.arange(0.5, 50), np.arange(-5.5, 6)), axis=-1).reshape(-1, 2)
    return np.column_stack((at, height(at) + np.random.default_rng(seed).normal(0, std, len(at))))


@pytest.mark.parametrize("std", [0.0, 0.01, 0.1])
def test_a_plane_stays_one_at_any_noise(std):
    assert sum(leaves_plane(cells(std=std, seed=seed)) for seed in range(20)) <= 2


@pytest.mark.parametrize(
    "height",
    [
        lambda at: 0.001 * (at[:, 0] - 20) ** 2 - 0.1,
        lambda at: 0.004 * at[:, 0] - 0.06,
        lambda at: 0.02 * np.sign(at[:, 1]),
    ],
    ids=["crest", "tilted plane", "crown"],
)
@pytest.mark.parametrize("std", [0.0, 0.01])
def test_what_leaves_its_plane_is_told(height, std):
    assert leaves_plane(cells(height, std))


def test_what_noise_hides_is_none():
    assert leaves_plane(cells(lambda at: 0.004 * np.sin(at[:, 0] / 8), 0.001))
    assert not leaves_plane(cells(lambda at: 0.004 * np.sin(at[:, 0] / 8), 0.05))


def test_one_bump_is_no_hill():
    assert not leaves_plane(cells(lambda at: 0.2 * ((at[:, 0] > 20) & (at[:, 0] < 24)), 0.01))


def test_a_few_cells_on_a_kerb_do_not_count():
    assert not leaves_plane(cells(lambda at: 0.15 * (at[:, 1] > 3), 0.005))


@pytest.mark.parametrize("points", [np.empty((0, 3)), cells()[:4], cells(lambda at: 0.1 * at[:, 0], ahead_m=60.0)])
def test_without_cells_near_the_car_the_plane_stays(points):
    assert not leaves_plane(points)


@pytest.mark.parametrize(("grade", "model"), [(0.0, "plane"), (0.08, "spline"), (-0.05, "spline")])
def test_auto_is_the_model_that_the_road_asks_for(grade, model):
    hill = replace(FLAT, grade=grade)
    depth_m = hill.depth_m() * np.random.default_rng(1).normal(1, 0.01, hill.depth_m().shape).astype(np.float32)
    depth = DepthMap(depth_m, hill.camera, hill.ego_T_camera, np.inf, "depth")
    road = np.isin(hill.tags(), (ROAD, LINE))
    auto, chosen = (
        fit_surface(SurfaceConfig(model=name), depth, road, np.random.default_rng(0)) for name in ("auto", model)
    )
    assert auto.model == model
    assert auto.plane == chosen.plane
    assert (auto.height_grid is None) == (model == "plane")
    if auto.height_grid is not None:
        assert np.array_equal(auto.height_grid.z_m, chosen.height_grid.z_m)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_the_median_is_numpys(values):
    assert median(np.array(values)) == np.median(values)
