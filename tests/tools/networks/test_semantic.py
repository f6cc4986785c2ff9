"""Masks of the road and its markings, without the faults of small networks."""

import numpy as np
import pytest

from roadperc_stream.tools.networks import semantic
from roadperc_stream.tools.networks.description import SegmentationKeys
from roadperc_stream.tools.networks.semantic import HorizonEstimate, RoadMasks

SIZE = HEIGHT, WIDTH = 54, 96
HORIZON = 20
NO_BOXES = np.empty((0, 4))


def keys(**options):
    return SegmentationKeys(decoder="heads", classes={"lane": "road"}, **options)


@pytest.fixture
def road():
    """Road from the horizon to the image's bottom."""
    mask = np.zeros(SIZE, bool)
    mask[HORIZON:] = True
    return mask


@pytest.fixture
def marking():
    """A marking along a diagonal, 12 pixels wide in each row."""
    mask = np.zeros(SIZE, bool)
    for row in range(HORIZON, HEIGHT):
        mask[row, row + 10 : row + 22] = True
    return mask


def test_scores_are_interpolated_between_the_networks_pixels():
    ramp = np.tile(np.arange(8, dtype=np.float32), (1, 4, 1))
    scores = semantic.full_size_scores(ramp, (8, 16))
    assert scores.shape == (1, 8, 16)
    assert scores[0, 3, 1:15] == pytest.approx(np.arange(14) / 2 + 0.25)


def test_scores_that_differ_by_rounding_are_the_same():
    scores = np.random.default_rng(0).integers(-640, 640, (2, 5, 5)).astype(np.float32) / 64
    assert np.array_equal(semantic.full_size_scores(scores + 0.005, SIZE), semantic.full_size_scores(scores, SIZE))


def test_the_horizon_is_the_median_of_the_roads_top_rows(road):
    horizon = HorizonEstimate()
    assert horizon.after(np.zeros(SIZE, bool)).row is None
    high, wide = road.copy(), np.tile(road, 10)
    high[3] = wide[3, 3] = True  # one pixel is below 1 % of the columns
    for mask in (road, high, road):
        horizon = horizon.after(mask)
    assert horizon.row == HorizonEstimate().after(wide).row == HORIZON
    for _ in range(200):
        horizon = horizon.after(high)
    assert horizon.row == 3


def test_markings_become_as_wide_as_on_the_road_about_their_middle(road, marking):
    narrow = semantic.with_marking_width(RoadMasks(road, marking), HORIZON, 0.25)
    rows = np.arange(HORIZON + 8, HEIGHT)
    widths = narrow.markings[rows].sum(axis=1)
    assert np.abs(widths - 0.25 * (rows - HORIZON)).max() <= 1.0
    middles = [np.flatnonzero(narrow.markings[row]).mean() - row for row in rows]
    assert np.abs(np.array(middles) - 15.5).max() <= 0.5
    assert not narrow.markings[: HORIZON + 1].any()


def test_pixels_that_are_no_longer_marked_become_road_on_the_roads_side_only(road, marking):
    left = road & (np.arange(WIDTH) < np.arange(HEIGHT)[:, None] + 10)
    narrow = semantic.with_marking_width(RoadMasks(left, marking), HORIZON, 0.1)
    row = 50
    freed = np.flatnonzero(narrow.drivable[row] & ~left[row])
    assert (freed[0], freed[-1]) == (60, 65)


def test_holes_before_the_car_are_filled_except_with_a_box_or_beside_the_road(road):
    holed = road.copy()
    holed[45:, 30:50] = holed[50:, :20] = holed[45:50, 60:70] = False
    assert np.array_equal(semantic.without_holes(holed, np.ones(SIZE, bool), NO_BOXES), road)
    holed = road.copy()
    holed[45:, 30:50] = False
    holed[:, 80:] = False  # a verge
    holed[22:26, 10:15] = False  # a hole far ahead
    seen = np.ones(SIZE, bool)
    box = np.array([[25.0, 40.0, 40.0, 60.0]])
    assert np.array_equal(semantic.without_holes(holed, seen, box), holed)
    assert not semantic.without_holes(np.zeros(SIZE, bool), seen, NO_BOXES).any()


def test_a_box_in_a_far_hole_does_not_keep_the_near_hole_below_it(road):
    holed = road.copy()
    holed[30:, 30:50] = False
    filled = semantic.without_holes(holed, np.ones(SIZE, bool), np.array([[30.0, 28.0, 50.0, 34.0]]))
    assert filled[37:].all()
    assert not filled[30:37, 30:50].any()


def test_pixels_outside_the_region_and_of_the_bonnet_belong_to_no_class(road, marking):
    cfg = keys(roi=((0.0, 0.0), (0.5, 0.0), (0.5, 1.0), (0.0, 1.0)), ignore_below=0.9, fill_holes=True)
    holed = road.copy()
    holed[44:, 5:20] = False
    horizon, masks = semantic.corrected(cfg, 1.3, HorizonEstimate(), RoadMasks(holed, marking), NO_BOXES)
    assert horizon.row == HORIZON
    assert masks.drivable[HORIZON:49, :48].all()
    for mask in (masks.drivable, masks.markings):
        assert not mask[49:].any()
        assert not mask[:, 49:].any()


def test_a_marking_at_the_images_edge_stays_inside(road):
    marking = np.zeros(SIZE, bool)
    marking[30:, :3] = marking[30:, -3:] = True
    wide = semantic.with_marking_width(RoadMasks(road, marking), HORIZON, 1.0).markings
    assert wide[53, 0]
    assert wide[53, -1]
    assert not wide[53, 40:60].any()


def test_without_corrections_the_masks_stay(road, marking):
    _, masks = semantic.corrected(keys(), 1.3, HorizonEstimate(), RoadMasks(road, marking), NO_BOXES)
    assert np.array_equal(masks.drivable, road)
    assert np.array_equal(masks.markings, marking)
