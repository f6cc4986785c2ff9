"""The bird's-eye grid: a road with a board on it, hidden and unknown cells, and missing inputs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream import geometry as g
from roadperc_stream.chain.stages.occupancy import FREE, OCCUPIED, UNKNOWN, build
from roadperc_stream.config import OccupancyConfig, load_config
from roadperc_stream.errors import ConfigError
from roadperc_stream.model import Absent, Reason
from tests.analytic import LINE, OTHER, ROAD, VEHICLE, Road
from tests.hills import Hill
from tests.scenes import scene_of

CFG = OccupancyConfig()
WIDE = Road(left_m=6.0, right_m=-6.0)
CAR = (12.0, -1.0, 1.0, 1.5)
"""x of its rear, y from and to, height."""


def surface_of(road):
    ego_plane = g.Plane.of(np.array([0.0, 0.0, 1.0]), 0.0)
    return replace(Hill().surface(), plane=road.plane, ego_plane=ego_plane, model="plane", height_grid=None)


def pictures(road=WIDE, block=None, tag=VEHICLE, bottom_m=0.0):
    """Depth, tags and drivable pixels, with a board across the road at ``block``."""
    depth_m, tags = road.depth_m(), road.tags()
    if block is not None:
        x, y_min, y_max, height_m = block
        rows, columns = np.indices(depth_m.shape, dtype=float)
        rays = g.rays(road.camera, np.stack((columns, rows), axis=-1)) @ road.ego_T_camera[:3, :3].T
        t = x / rays[..., 0]
        y, z = t * rays[..., 1], road.height_m + t * rays[..., 2]
        hit = (y >= y_min) & (y <= y_max) & (z >= bottom_m) & (z <= height_m) & ~(depth_m < t)
        depth_m[hit], tags[hit] = t[hit], tag
    drivable = np.isin(tags, (ROAD, LINE)) & np.isfinite(depth_m)
    return depth_m, tags, drivable


def grid(depth_m, tags, drivable, road=WIDE, cfg=CFG, surface=None):
    surface = surface_of(road) if surface is None else surface
    return build(cfg, scene_of(road.camera, road.ego_T_camera, depth_m=depth_m, tags=tags), surface, drivable)


def area(occupancy, x_min, x_max, y_min, y_max):
    res = occupancy.resolution_m
    rows = slice(round((y_min - occupancy.y_min_m) / res), round((y_max - occupancy.y_min_m) / res))
    columns = slice(round((x_min - occupancy.x_min_m) / res), round((x_max - occupancy.x_min_m) / res))
    return occupancy.cells[rows, columns]


def test_an_empty_road_is_free_without_holes_and_the_rest_is_unknown():
    occupancy = grid(*pictures())
    assert occupancy.cells.shape == (150, 200)
    assert (occupancy.x_min_m, occupancy.y_min_m, occupancy.resolution_m) == (0.0, -15.0, 0.2)
    assert (area(occupancy, 8, 40, -5.8, 5.8) == FREE).all()
    assert (occupancy.cells != OCCUPIED).all()
    assert (area(occupancy, 0, 40, 10, 15) == UNKNOWN).all()
    assert (area(occupancy, 0, 1, -15, 15) == UNKNOWN).all()


@pytest.mark.parametrize("tag", [VEHICLE, OTHER, ROAD])
def test_a_board_is_occupied_and_the_road_behind_it_unknown(tag):
    depth_m, tags, drivable = pictures(block=CAR, tag=tag)
    drivable &= depth_m > 12.1 if tag == ROAD else True
    drivable |= (tags == ROAD) & (depth_m < 11.9)
    occupancy = grid(depth_m, tags, drivable)
    assert (area(occupancy, 11.8, 12.2, -0.8, 0.8) == OCCUPIED).any(axis=1).all()
    assert (area(occupancy, 12.4, 40, -0.8, 0.8) == UNKNOWN).all()
    assert (area(occupancy, 4, 11.6, -0.8, 0.8) == FREE).all()
    assert (area(occupancy, 8, 40, 4, 5.6) == FREE).all()
    rows, columns = np.nonzero(occupancy.cells == OCCUPIED)
    assert np.abs(occupancy.x_min_m + 0.2 * (columns + 0.5) - 12).max() < 0.2
    assert np.abs(occupancy.y_min_m + 0.2 * (rows + 0.5)).max() < 1.2


def test_a_board_on_a_hill():
    hill = Hill(left_m=6.0, right_m=-6.0, height_m=1.4, width=320, height=240)
    occupancy = grid(*pictures(hill), hill, surface=hill.surface())
    assert (area(occupancy, 8, 30, -5.6, 5.6) == FREE).all()
    assert (occupancy.cells != OCCUPIED).all()
    assert not (area(grid(*pictures(hill), hill), 8, 30, -5.6, 5.6) == FREE).all()
    hidden = grid(*pictures(hill, CAR), hill, surface=hill.surface())
    assert (area(hidden, 11.8, 12.2, -0.8, 0.8) == OCCUPIED).any(axis=1).all()
    assert (area(hidden, 12.4, 30, -0.8, 0.8) == UNKNOWN).all()


def test_low_points_are_obstacles_only_by_their_class_and_high_ones_never():
    low = (12.0, -1.0, 1.0, 0.2)
    assert (grid(*pictures(block=low, tag=VEHICLE)).cells == OCCUPIED).any()
    assert (grid(*pictures(block=low, tag=OTHER)).cells != OCCUPIED).all()
    for block, occupied in ((low, False), (CAR, True)):
        depth_m, _, drivable = pictures(block=block)
        assert (grid(depth_m, None, drivable).cells == OCCUPIED).any() == occupied
    above = grid(*pictures(block=(12.0, -3.0, 3.0, 4.0), tag=OTHER, bottom_m=2.6))
    assert (above.cells != OCCUPIED).all()
    assert (area(above, 8, 40, -3, 3) == FREE).all()


def test_occupied_wins_over_free():
    depth_m, tags, drivable = pictures(block=CAR)
    occupancy = grid(depth_m, tags, np.ones_like(drivable))
    assert (area(occupancy, 12.0, 12.2, 0.0, 0.2) == OCCUPIED).all()


def test_single_pixels_change_nothing():
    depth_m, tags, drivable = pictures()
    depth_m[300, 320] = 6.0
    drivable[400, 320] = False
    depth_m[380, ::40] = np.nan
    drivable[380, ::40] = False
    occupancy = grid(depth_m, tags, drivable)
    assert (area(occupancy, 8, 40, -5.6, 5.6) == FREE).all()
    assert (occupancy.cells != OCCUPIED).all()


def test_cells_hidden_by_a_crest_are_unknown():
    crest = Hill(left_m=6.0, right_m=-6.0, grade=0.2, wave_m=60.0, width=320, height=240)
    occupancy = grid(*pictures(crest), crest, surface=crest.surface())
    assert (area(occupancy, 36, 40, -2, 2) == UNKNOWN).all()
    assert (area(occupancy, 8, 24, -2, 2) == FREE).all()


@settings(max_examples=8)
@given(st.floats(5.0, 30.0), st.floats(-4.0, 4.0))
def test_a_board_is_occupied_at_its_place(x, y):
    occupancy = grid(*pictures(block=(x, y - 0.5, y + 0.5, 1.5)))
    rows, columns = np.nonzero(occupancy.cells == OCCUPIED)
    assert len(rows)
    assert np.abs(0.2 * (columns + 0.5) - x).max() < 0.2
    assert np.abs(-15 + 0.2 * (rows + 0.5) - y).max() < 0.7


def test_the_depth_tolerance_decides_if_road_and_depth_disagree():
    depth_m, tags, drivable = pictures()
    cfg = OccupancyConfig(min_points=10_000)
    strict = cfg.model_copy(update={"depth_tolerance": 0.01})
    off_by_a_twentieth = (1.05 * depth_m).astype(np.float32)
    ahead = [area(grid(off_by_a_twentieth, tags, drivable, cfg=c), 8, 15, -2, 2) for c in (cfg, strict)]
    assert (ahead[0] == FREE).all()
    assert (ahead[1] == UNKNOWN).all()


@pytest.mark.parametrize(
    "setting", ["x_max_m=0.1", "max_height_m=0.2", "resolution_m=0.001", "x_max_m=80", 'obstacle_classes=["ghost"]']
)
def test_settings_that_do_not_fit_are_refused(setting):
    with pytest.raises(ConfigError, match="occupancy"):
        load_config(None, (f"occupancy.{setting}",))


def test_a_missing_input_has_a_reason_and_unknown_depth_gives_unknown_cells():
    depth_m, tags, drivable = pictures()
    no_plane, no_depth = Reason("surface", "plane_without_points"), Reason("drivable", "no_depth_no_segmentation")
    assert grid(None, tags, drivable) == Absent(Reason("occupancy", "no_depth"))
    without_surface = Reason("occupancy", "no_surface", cause=no_plane)
    assert grid(depth_m, tags, drivable, surface=Absent(no_plane)) == Absent(without_surface)
    without_drivable = Reason("occupancy", "no_drivable_surface", cause=no_depth)
    assert grid(depth_m, tags, Absent(no_depth)) == Absent(without_drivable)
    assert (grid(np.full_like(depth_m, np.nan), tags, drivable).cells == UNKNOWN).all()
