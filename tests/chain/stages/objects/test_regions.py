"""Regions of one class, divided at jumps of the depth, on cars drawn by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import label

from roadperc_stream.chain.stages.objects import regions
from roadperc_stream.chain.stages.objects.mosaic import LONGEST_SIDE, Mosaic, cut_out
from roadperc_stream.chain.stages.objects.regions import (
    JUMPS,
    MISSING_WEIGHT,
    divide,
    find_regions,
    of_region,
)
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box
from roadperc_stream.model.tag_tables import label_lookup
from tests.analytic import TABLE, VEHICLE
from tests.scenes import scene_of

CAMERA = Camera("camera", 200, 120, 100.0, 100.0, 99.5, 59.5)
NEAR, FAR = Box(60, 40, 100, 80), Box(80, 30, 140, 60)
"""A near car that covers the lower left of a far one."""


def rows_of_cars(noise=0.0):
    rng = np.random.default_rng(0)
    tags, depth = np.zeros(CAMERA.size, np.uint8), np.full(CAMERA.size, 50.0, np.float32)
    for box, depth_m in ((FAR, 20.0), (NEAR, 12.0)):
        part = slice(int(box.y_min), int(box.y_max)), slice(int(box.x_min), int(box.x_max))
        tags[part], depth[part] = VEHICLE, depth_m
    return tags, (depth * (1 + noise * rng.standard_normal(depth.shape))).astype(np.float32)


def regions_of(*boxes, tags=None, depth=None, instances=None):
    if tags is None:
        tags, depth = rows_of_cars()
    scene = scene_of(CAMERA, tags=tags, depth_m=depth, instances=instances)
    lookup = label_lookup(TABLE, "Car")
    return find_regions(CAMERA, cut_out(scene, [lookup] * len(boxes), boxes), boxes)


def distances_m(region):
    """The distances of the region's pixels."""
    mask, part = region.division.of_region(region.number)
    return region.division.mosaic.distances_m[part][mask]


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.02])
def test_a_car_behind_another_is_a_region_of_its_own(noise):
    tags, depth = rows_of_cars(noise)
    near, far = (regions[0] for regions in regions_of(NEAR, FAR, tags=tags, depth=depth))
    assert (near.box_px.overlap(NEAR), far.box_px.overlap(FAR)) > (0.9, 0.9)
    assert np.median(distances_m(near)) == pytest.approx(12.5, abs=0.5)
    assert np.median(distances_m(far)) == pytest.approx(21.0, abs=1.0)


@pytest.mark.parametrize(("fit", "next_m", "least_m", "most_m"), [(1.0, 0, 0, 1), (0.8, 0, 3, 3.2), (1.0, 5, 4, 6)])
def test_a_far_region_that_may_be_another_car_of_a_row_is_uncertain(fit, next_m, least_m, most_m):
    """A car 45 m away, and pixels of the next one in most of its region."""
    tags, depth = rows_of_cars()
    depth[:] = 60.0
    depth[30:60, 80:140] = 45.0
    ((region, *_),) = regions_of(FAR, tags=tags, depth=depth)
    distances = region.division.mosaic.distances_m.copy()
    distances[:, int(region.division.bounds[0, region.number]) + 10 :] += next_m
    division = replace(region.division, mosaic=replace(region.division.mosaic, distances_m=distances))
    std_m = of_region(ObjectsConfig(), replace(region, fit=fit, division=division)).std_m
    assert least_m <= std_m <= most_m


def test_the_order_of_boxes_does_not_matter():
    one, other = regions_of(NEAR, FAR), regions_of(FAR, NEAR)
    assert [r.fit for r in one[0]] == [r.fit for r in other[1]]
    assert [r.box_px for r in one[1]] == [r.box_px for r in other[0]]
    assert [r.fit for r in regions_of(FAR)[0]] == [r.fit for r in one[1]]


def test_a_side_that_recedes_is_not_divided():
    """From 8 m to 16 m over 40 columns: 2 % a column."""
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[40:80, 60:100] = VEHICLE
    depth = np.full(CAMERA.size, 50.0, np.float32)
    depth[:, 60:100] = np.geomspace(8.0, 16.0, 40, dtype=np.float32)
    (region,) = regions_of(NEAR, tags=tags, depth=depth)[0][:1]
    assert region.box_px == NEAR


def test_a_line_one_pixel_high_above_a_nearer_car_is_found():
    tags, depth = rows_of_cars()
    tags[39, 60:100], depth[39, 60:100] = VEHICLE, 17.0
    found = regions_of(Box(60, 39, 100, 41), tags=tags, depth=depth)[0]
    assert [r for r in found if r.box_px.y_max == 40 and distances_m(r).min() > 16.9]


def test_a_hidden_part_of_the_box_costs_less_than_a_part_outside():
    wider, narrower = Box(40, 40, 120, 80), Box(70, 40, 90, 80)
    of_wider, of_narrower = (regions[0].fit for regions in regions_of(wider, narrower))
    assert of_wider == pytest.approx(1 / (1 + MISSING_WEIGHT))
    assert of_narrower < 0.7 < of_wider


def test_instances_divide_at_equal_depth():
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[40:80, 60:140] = VEHICLE
    ids = np.zeros(CAMERA.size, np.uint16)
    ids[40:80, 60:100], ids[40:80, 100:140], ids[:, 150:] = 70, 9, 3
    left, right = Box(60, 40, 100, 80), Box(100, 40, 140, 80)
    depth = np.full(CAMERA.size, 10.0, np.float32)
    found = regions_of(left, right, tags=tags, depth=depth, instances=ids)
    assert [regions[0].box_px for regions in found] == [left, right]
    assert [regions[0].fit for regions in found] == [1.0, 1.0]
    without_depth = regions_of(left, right, tags=tags, instances=ids)
    assert [regions[0].box_px for regions in without_depth] == [left, right]
    assert without_depth[0][0].division.mosaic.distances_m is None


def test_isolated_pixels_and_pairs_belong_to_no_region():
    tags = np.zeros(CAMERA.size, np.uint8)
    tags[12, 12:15], tags[15, 15:17] = VEHICLE, VEHICLE
    scene = scene_of(CAMERA, tags=tags, depth_m=np.full(CAMERA.size, 5.0, np.float32))
    mosaic = cut_out(scene, [label_lookup(TABLE, "Car")], [Box(10, 10, 20, 20)])
    rows, columns = np.nonzero(mosaic.of_class)
    assert [(c + x, r + y) for c, r in zip(columns, rows, strict=True) for x, y in mosaic.first_px] == [(13, 12)]
    assert mosaic.of_class.max() == 1


def test_large_boxes_are_sampled_within_the_image():
    camera = Camera("camera", 1000, 800, 500.0, 500.0, 499.5, 399.5)
    tags = np.full(camera.size, VEHICLE, np.uint8)
    scene = scene_of(camera, tags=tags, depth_m=np.full(camera.size, 5.0, np.float32))
    box = Box(-50, -50, 1200, 300)
    mosaic = cut_out(scene, [label_lookup(TABLE, "Car")], [box])
    assert max(mosaic.of_class.shape) <= LONGEST_SIDE + 1
    (region,) = find_regions(camera, mosaic, [box])[0]
    assert (region.box_px.x_min, region.box_px.y_min) == (0, 0)
    assert region.fit > 0.75


@pytest.mark.parametrize(
    "box", [Box(300, 10, 320, 30), Box(50, 50, 50, 50), Box(-40, -40, -20, -20), Box(-1e308, 5, -9e307, 9)]
)
def test_boxes_without_pixels_have_no_regions(box):
    assert regions_of(box, NEAR)[0] == ()
    assert regions_of(box) == [()]
    assert regions_of() == []


def test_unknown_depth_does_not_divide_or_measure():
    tags, depth = rows_of_cars()
    (region,) = regions_of(NEAR, tags=tags, depth=np.full_like(depth, np.nan))[0][:1]
    assert not distances_m(region).any()


def mosaic_of(of_class, log_depth):
    ends = np.array([0, len(of_class)])
    steps = np.ones((1, 2), int)
    return Mosaic(steps - 1, steps, ends, of_class, None, of_class, log_depth, None, None, None, None)


def connected(of_class, log_depth, jump):
    """The connected sets of pixels, by a flood fill over a grid of pixels and the links between them."""
    height, width = of_class.shape
    grid = np.zeros((2 * height - 1, 2 * width - 1), bool)
    grid[::2, ::2] = of_class
    grid[::2, 1::2] = of_class[:, 1:] & of_class[:, :-1] & (np.abs(np.diff(log_depth, axis=1)) < jump)
    grid[1::2, ::2] = of_class[1:] & of_class[:-1] & (np.abs(np.diff(log_depth, axis=0)) < jump)
    labels, count = label(grid)
    return {frozenset(map(tuple, np.argwhere(labels[::2, ::2] == k + 1).tolist())) for k in range(count)}


def pixels_of(division):
    for k in range(len(division.pixels)):
        mask, (rows, columns) = division.of_region(k)
        assert mask.any(axis=0)[[0, -1]].all()
        assert mask.any(axis=1)[[0, -1]].all()
        assert mask.sum() == division.pixels[k]
        yield frozenset(map(tuple, (np.argwhere(mask) + np.array((rows.start, columns.start))).tolist()))


def test_each_region_of_each_jump_once():
    rng = np.random.default_rng(0)
    for _ in range(20):
        of_class = (rng.random((24, 17)) < 0.7).astype(np.uint8)
        log_depth = rng.choice(np.arange(0.0, 0.2, 0.013), of_class.shape).astype(np.float32)
        division = divide(mosaic_of(of_class, log_depth))
        found = list(pixels_of(division))
        expected = [connected(of_class, log_depth, jump) for jump in JUMPS]
        assert len(set(found)) == len(found)
        assert set(found) == set.union(*expected)
        assert {r for r, way in zip(found, division.ways, strict=True) if way == 0} == expected[0]


def test_no_pixels_of_the_class():
    division = divide(mosaic_of(np.zeros((5, 4), np.uint8), np.zeros((5, 4), np.float32)))
    assert (division.bounds.shape, division.pixels.shape) == ((4, 0), (0,))


def test_a_distance_is_the_mean_of_the_regions_known_ones_around_it():
    of_region = np.array([[1, 1, 1, 1], [0, 1, 1, 0]], bool)
    near_m, known = regions._smoothed(of_region, np.float32([[1, 2, 0, 0], [100, 6, 9, 100]]))
    assert near_m.tolist() == [3.0, 4.5, 4.5, np.float32(17 / 3)]
    assert known.tolist() == [[True, True, False, False], [False, True, True, False]]
