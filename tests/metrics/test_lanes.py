"""The two boundaries against truth, on the road and in the image, with answers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.geometry import inverse, project, transform
from roadperc_stream.metrics.lanes import (
    TuSimpleScore,
    columns_at,
    counts_above,
    lane_angle,
    lane_benchmarks,
    lane_error_m,
    line_overlaps,
    true_lane_columns,
    tusimple,
)
from roadperc_stream.model import Absent, Boundary, Lanes, Reason
from roadperc_stream.schemas.columns.errors import LaneScoreColumns, TrueLaneColumns
from tests.analytic import Road
from tests.metrics.frames import boundary

ROAD = Road(width=1280, height=720)
COUNTS = [f"lane_culane_{name}_{percent}" for percent in (50, 30) for name in ("tp", "fp", "fn")]


def test_lane_error_is_taken_ten_metres_ahead_and_needs_both_boundaries():
    assert lane_error_m(boundary(1.8, 0.01), boundary(1.8)) == pytest.approx(0.1)
    assert lane_error_m(boundary(1.55), boundary(1.8)) == pytest.approx(-0.25)
    assert lane_error_m(boundary(1.8), boundary(1.8)) == 0.0
    assert lane_error_m(Boundary("left", "lost"), boundary(1.8)) is None
    assert lane_error_m(boundary(1.8), Boundary("left", "measured")) is None


def seen(true, right_px=0.0, road=ROAD):
    """A boundary at the pixels of the true one, moved to the right by ``right_px`` columns."""
    line_px = project(road.camera, transform(inverse(road.ego_T_camera), true.line_ego_m[1:]))
    return replace(true, line_px=line_px + np.array([right_px, 0.0]))


TRUTH = Lanes((boundary(1.8), boundary(-1.9, side="right")))


@pytest.mark.parametrize(
    ("found", "points", "counts"),
    [
        ((seen(TRUTH.side("left"), 128), seen(TRUTH.side("right"))), [0.5, 0.5, 0.5], [1, 1, 1, 1, 1, 1]),
        ((Boundary("left", "lost"), Boundary("right", "lost")), [0.0, 0.0, 1.0], [0, 0, 2, 0, 0, 2]),
    ],
    ids=["one moved by a tenth of the image", "both lost"],
)
def test_a_boundary_at_a_wrong_place_is_missed(found, points, counts):
    columns = lane_benchmarks(Lanes(found), TRUTH, ROAD.camera, ROAD.ego_T_camera)
    assert [getattr(columns, f"lane_tusimple_{name}") for name in ("accuracy", "fp", "fn")] == points
    assert [getattr(columns, name) for name in COUNTS] == counts


NOTHING = Absent(Reason("lanes", "not_run"))


@pytest.mark.parametrize("scale", [1, 2])
@pytest.mark.parametrize(("shift_px", "expected"), [(10.0, (0.0, 0, 1)), (18.0, (0.0, 0, 0)), (36.0, (1.0, 0, 0))])
def test_thresholds_and_drawn_lines_grow_with_the_image(scale, shift_px, expected):
    """In 1280 columns a point may be off by 20 px. Lines are 23 px wide: moved by 10, they share 13 of 33 columns."""
    road, true = replace(ROAD, width=1280 // scale, height=720 // scale), boundary(0.1)
    found = Lanes((seen(true, shift_px / scale, road),))
    score = lane_benchmarks(found, Lanes((true,)), road.camera, road.ego_T_camera)
    assert (score.lane_tusimple_fn, score.lane_culane_tp_50, score.lane_culane_tp_30) == expected


@pytest.mark.parametrize(
    ("found", "truth"),
    [
        (TRUTH, None),
        (NOTHING, TRUTH),
        (TRUTH, Lanes(())),
        (TRUTH, Lanes((boundary(900.0),))),
    ],
)
def test_nothing_is_scored_without_truth_in_the_image(found, truth):
    assert lane_benchmarks(found, truth, ROAD.camera, ROAD.ego_T_camera) == LaneScoreColumns()


def test_a_line_behind_a_crest_is_not_scored():
    """Heights rise to a crest 10 m ahead and fall steeply behind it: the far part is drawn over the near one."""
    x = np.arange(0.0, 40.0)
    line = np.stack((x, np.full_like(x, 1.8), np.where(x < 10, 0.05 * x, 0.5 - 0.3 * (x - 10))), axis=-1)
    hill = Lanes((replace(boundary(1.8), line_ego_m=line),))
    near = seen(replace(hill.side("left"), line_ego_m=line[:11]))
    found = Lanes((replace(hill.side("left"), line_px=near.line_px),))
    columns = lane_benchmarks(found, hill, ROAD.camera, ROAD.ego_T_camera)
    assert (columns.lane_tusimple_accuracy, columns.lane_culane_tp_50) == (1.0, 1)


def test_columns_at_rows():
    line_px = np.array([(100.0, 700.0), (200.0, 600.0), (1400.0, 500.0)])
    found = columns_at(line_px, np.array([590.0, 650.0, 710.0, 505.0]), ROAD.camera)
    np.testing.assert_allclose(found, [320.0, 150.0, np.nan, np.nan])


def test_true_offsets_come_from_the_truth():
    assert true_lane_columns(NOTHING, TRUTH) == TrueLaneColumns(1.8, -1.9)
    assert true_lane_columns(NOTHING, None) == TrueLaneColumns()
    beside = replace(TRUTH, boundaries=tuple(replace(b, outside=f"{b.side} class") for b in TRUTH.boundaries))
    columns = true_lane_columns(NOTHING, beside)
    assert columns.lane_left_true_boundary_class == "left class"
    assert columns.lane_right_true_boundary_class == "right class"


@pytest.mark.parametrize(
    ("lost", "expected"), [((), 2.0), (("left",), 3.0), (("right",), 1.0), (("left", "right"), None)]
)
def test_the_true_heading_is_that_of_the_boundaries_that_are_found(lost, expected):
    truth = Lanes((boundary(1.8, np.radians(1.0)), boundary(-1.9, np.radians(3.0), side="right")))
    found = Lanes(tuple(Boundary(b.side, "lost") if b.side in lost else b for b in TRUTH.boundaries))
    assert true_lane_columns(found, truth).lane_true_heading_deg == (expected and pytest.approx(expected))
    unknown = Lanes((truth.side("left"), replace(truth.side("right"), heading=None)))
    assert true_lane_columns(TRUTH, unknown).lane_true_heading_deg is None


ROWS = np.arange(160.0, 720.0, 10.0)
SHAPE = (590, 1640)


def upright(x):
    return np.full_like(ROWS, x)


def line(x, bottom=589, top=0):
    return np.array([(x, bottom), (x, top)], float)


def culane(predicted, truth, shape, threshold=0.5):
    return counts_above(line_overlaps(predicted, truth, shape), threshold)


@pytest.mark.parametrize(("moved_px", "expected"), [(19, (1.0, 0.0, 0.0)), (20, (0, 1, 1))])
def test_an_upright_lane_is_right_below_twenty_pixels(moved_px, expected):
    assert tusimple([upright(300 + moved_px)], [upright(300.0)], ROWS) == expected


def test_the_threshold_of_a_slanting_lane_grows_by_the_cosine():
    """At a slope of 3 : 4 the cosine is 0.8, and 20 px become 25."""
    lane = 0.75 * ROWS
    assert lane_angle(lane, ROWS) == pytest.approx(np.arctan(0.75))
    assert tusimple([lane, lane + 24.9], [lane, lane + 24.9], ROWS) == (1.0, 0.0, 0.0)
    assert tusimple([lane + 24.9], [lane], ROWS).accuracy == 1.0
    assert tusimple([lane + 25.1], [lane], ROWS).accuracy == 0.0


def test_a_lane_is_found_at_85_percent_of_its_points():
    """Of 20 rows 17 are 0.85 and 16 are 0.8."""
    rows = np.arange(0.0, 200.0, 10.0)
    truth = np.full(20, 300.0)
    for right, missed in ((17, 0.0), (16, 1.0)):
        lane = np.where(np.arange(20) < right, 300.0, 400.0)
        assert tusimple([lane], [truth], rows) == TuSimpleScore(right / 20, missed, missed)


def test_points_absent_in_both_lanes_are_right():
    truth = np.where(ROWS < 400, np.nan, 300.0)
    assert tusimple([truth], [truth], ROWS).accuracy == 1.0
    assert tusimple([upright(300.0)], [truth], ROWS).accuracy == pytest.approx(np.mean(ROWS >= 400))


@pytest.mark.parametrize(
    ("found", "true", "score", "counts"),
    [
        (0, 0, (0, 0, 0), (0, 0, 0)),
        (0, 1, (0, 0, 1), (0, 0, 1)),
        (1, 0, (0, 1, 0), (0, 1, 0)),
        (1, 2, (1 / 2, 0, 1 / 2), (1, 0, 1)),
        (2, 1, (1, 1 / 2, 0), (1, 1, 0)),
        (3, 1, (1, 2 / 3, 0), (1, 2, 0)),
        pytest.param(4, 1, (0, 0, 1), (1, 3, 0), id="more than two lanes too many are no answer"),
        (5, 5, (1, 0, 0), (5, 0, 0)),
        pytest.param(4, 5, (1, 0, 0), (4, 0, 1), id="the worst of five true lanes is forgiven"),
        pytest.param(3, 5, (3 / 4, 0, 1 / 4), (3, 0, 2), id="and no other"),
    ],
)
def test_found_and_missed_lanes(found, true, score, counts):
    places = [100.0, 300.0, 500.0, 700.0, 900.0]
    lanes, drawn = [upright(x) for x in places], [line(x) for x in places]
    assert tusimple(lanes[:found], lanes[:true], ROWS) == pytest.approx(score)
    assert culane(drawn[:found], drawn[:true], SHAPE) == counts


def test_the_overlap_of_two_upright_lines():
    """Lines 30 px wide, 10 px apart: 20 of 40 columns are shared; 25 px apart 5 of 55."""
    overlaps = line_overlaps([line(800), line(815)], [line(810), line(825)], SHAPE)
    expected = [[20 / 40, 5 / 55], [25 / 35, 20 / 40]]
    np.testing.assert_allclose(overlaps, expected, atol=0.03)


@pytest.mark.parametrize("far_px", [2.0**15, 1e12])
@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize("direction", [(1, 0), (0, 1), (0.6, -0.8), (-0.28, 0.96)])
def test_a_line_leaves_the_image_in_its_direction(far_px, direction, is_first):
    """For a point close to the plane of the camera, the line equals one that ends just outside the image."""
    inner = np.array([(700.0, 300.0)])
    near, far = (np.vstack([inner, inner + reach * np.array(direction)]) for reach in (2000, far_px))
    order = slice(None, None, -1 if is_first else 1)
    assert line_overlaps([far[order]], [near[order]], SHAPE).item() == pytest.approx(1, abs=0.01)  # a column


def test_a_line_far_outside_is_not_drawn():
    """Also at the limit of drawn points; between two far ends, the part in the image is drawn."""
    beside = [np.array([(x, -1e9), (x, 1e9)]) for x in (1e7, -(2.0**14) - 1640, 2.0**14 + 1640)]
    np.testing.assert_array_equal(line_overlaps(beside, [line(800)], SHAPE), 0)
    across = np.array([(800, -1e9), (800, 1e9)])
    assert line_overlaps([across], [line(800)], SHAPE).item() == 1


@pytest.mark.parametrize(
    ("overlaps", "counts"),
    [
        pytest.param([[0.5]], (0, 1, 1), id="at the threshold is not above it"),
        pytest.param([[0.9, 0.8], [0.7, 0.0]], (2, 0, 0), id="the largest sum, not the best single pair"),
        pytest.param([[1.0], [0.9]], (1, 1, 0), id="two found lines do not share a true one"),
    ],
)
def test_lines_are_paired_by_their_overlaps(overlaps, counts):
    assert counts_above(np.array(overlaps), 0.5) == counts


lanes = st.lists(st.floats(0, 1280), max_size=4)


@given(lanes, lanes)
def test_scores_are_shares_and_counts_add_up(found, true):
    score = tusimple([upright(x) for x in found], [upright(x) for x in true], ROWS)
    assert all(0.0 <= value <= 1.0 for value in (score.accuracy, score.fn))
    assert score.fp <= 1.0
    tp, fp, fn = culane([line(x, 79) for x in found], [line(x, 79) for x in true], (80, 1280))
    assert (tp + fp, tp + fn) == (len(found), len(true))
