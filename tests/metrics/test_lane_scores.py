"""The lane benchmarks' scores with answers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.metrics.lane_scores import (
    Counts,
    TuSimpleScore,
    counts_above,
    lane_angle,
    line_overlaps,
    tusimple,
)

ROWS = np.arange(160.0, 720.0, 10.0)
SHAPE = (590, 1640)


def upright(x):
    return np.full_like(ROWS, x)


def line(x, bottom=589, top=0):
    return np.array([(x, bottom), (x, top)], float)


def culane(predicted, truth, shape, threshold=0.5):
    return counts_above(line_overlaps(predicted, truth, shape), threshold)


def test_the_true_lanes_score_full():
    lanes = [upright(300.0), 400 + 0.5 * ROWS]
    assert tusimple(lanes, lanes, ROWS) == TuSimpleScore(1.0, 0.0, 0.0)


@pytest.mark.parametrize(("moved_px", "expected"), [(19, (1.0, 0.0, 0.0)), (20, (0, 1, 1)), (25, (0, 1, 1))])
def test_an_upright_lane_is_right_below_twenty_pixels(moved_px, expected):
    assert tusimple([upright(300 + moved_px)], [upright(300.0)], ROWS) == expected


def test_a_slanting_lane_may_be_farther_off_by_the_cosine():
    """At a slope of 3 : 4 the cosine is 0.8, and 20 px become 25."""
    lane = 0.75 * ROWS
    assert lane_angle(lane, ROWS) == pytest.approx(np.arctan(0.75))
    assert tusimple([lane + 24.9], [lane], ROWS).accuracy == 1.0
    assert tusimple([lane + 25.1], [lane], ROWS).accuracy == 0.0


def test_a_lane_is_found_at_85_percent_of_its_points():
    """Of 20 rows 17 are 0.85 and 16 are 0.8."""
    rows = np.arange(0.0, 200.0, 10.0)
    truth = np.full(20, 300.0)
    for right, missed in ((17, 0.0), (16, 1.0)):
        lane = np.where(np.arange(20) < right, 300.0, 400.0)
        assert tusimple([lane], [truth], rows) == TuSimpleScore(right / 20, missed, missed)


def test_points_that_neither_lane_has_are_right():
    truth = np.where(ROWS < 400, np.nan, 300.0)
    assert tusimple([truth], [truth], ROWS).accuracy == 1.0
    assert tusimple([upright(300.0)], [truth], ROWS).accuracy == pytest.approx(np.mean(ROWS >= 400))


def test_of_two_true_lanes_one_is_missed():
    assert tusimple([upright(300.0)], [upright(300.0), upright(700.0)], ROWS) == TuSimpleScore(0.5, 0.0, 0.5)
    assert tusimple([upright(300.0), upright(700.0)], [upright(300.0)], ROWS) == TuSimpleScore(1.0, 0.5, 0.0)


def test_the_worst_of_five_true_lanes_is_forgiven():
    truth = [upright(x) for x in (100.0, 300.0, 500.0, 700.0, 900.0)]
    assert tusimple(truth, truth, ROWS) == TuSimpleScore(1.0, 0.0, 0.0)
    assert tusimple(truth[:4], truth, ROWS) == TuSimpleScore(1.0, 0.0, 0.0)
    assert tusimple(truth[:3], truth, ROWS) == TuSimpleScore(0.75, 0.0, 0.25)


def test_many_lanes_too_many_are_no_answer():
    lanes = [upright(100.0 * k) for k in range(1, 5)]
    assert tusimple(lanes[:3], lanes[:1], ROWS) == TuSimpleScore(1.0, pytest.approx(2 / 3), 0.0)
    assert tusimple(lanes, lanes[:1], ROWS) == TuSimpleScore(0.0, 0.0, 1.0)


def test_nothing_found_and_nothing_there():
    assert tusimple([], [upright(1.0)], ROWS) == TuSimpleScore(0.0, 0.0, 1.0)
    assert tusimple([upright(1.0)], [], ROWS) == TuSimpleScore(0.0, 1.0, 0.0)
    assert tusimple([], [], ROWS) == TuSimpleScore(0.0, 0.0, 0.0)
    assert culane([], [], SHAPE) == Counts(0, 0, 0)
    assert culane([line(9)], [], SHAPE) == Counts(0, 1, 0)
    assert culane([], [line(9)], SHAPE) == Counts(0, 0, 1)


def test_a_lane_needs_a_column_for_every_row():
    with pytest.raises(ValueError, match="expected a column for each of 56 rows, got 3"):
        tusimple([np.zeros(3)], [upright(0.0)], ROWS)


def test_the_overlap_of_two_upright_lines():
    """Lines 30 px wide, 10 px apart: 20 of 40 columns are shared; 25 px apart 5 of 55."""
    overlaps = line_overlaps([line(800), line(815)], [line(810), line(825)], SHAPE, 30)
    expected = [[20 / 40, 5 / 55], [25 / 35, 20 / 40]]
    np.testing.assert_allclose(overlaps, expected, atol=0.03)


@pytest.mark.parametrize("far_px", [2.0**15, 2.0**21, 1e9, 1e12])
@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize("direction", [(1, 0), (0, 1), (0.6, -0.8), (-0.28, 0.96)])
def test_a_line_that_leaves_the_image_goes_on_in_its_direction(far_px, direction, is_first):
    """As one of a point close to the plane of the camera: it is what it would be with an end just outside."""
    inner = np.array([(700.0, 300.0)])
    near, far = (np.vstack([inner, inner + reach * np.array(direction)]) for reach in (2000, far_px))
    order = slice(None, None, -1 if is_first else 1)
    assert line_overlaps([far[order]], [near[order]], SHAPE, 30).item() == pytest.approx(1, abs=0.01)  # a column


def test_a_line_far_outside_is_nowhere():
    """Also one on the very border of what is drawn, and between two far ends the part in the image is."""
    beside = [np.array([(x, -1e9), (x, 1e9)]) for x in (1e7, -(2.0**14) - 1640, 2.0**14 + 1640)]
    np.testing.assert_array_equal(line_overlaps(beside, [line(800)], SHAPE, 30), 0)
    across = np.array([(800, -1e9), (800, 1e9)])
    assert line_overlaps([across], [line(800)], SHAPE, 30).item() == 1


def test_a_line_moved_by_25_pixels_is_found_wrongly_and_missed():
    assert culane([line(825)], [line(800)], SHAPE) == Counts(0, 1, 1)
    assert culane([line(825)], [line(800)], SHAPE, threshold=0.3) == Counts(0, 1, 1)


def test_a_line_moved_by_13_pixels_is_found_at_the_looser_threshold_only():
    """17 of 43 columns are shared: 0.4."""
    assert culane([line(813)], [line(800)], SHAPE, threshold=0.5) == Counts(0, 1, 1)
    assert culane([line(813)], [line(800)], SHAPE, threshold=0.3) == Counts(1, 0, 0)


def test_a_pair_at_the_threshold_is_not_found():
    assert counts_above(np.array([[0.5]]), 0.5) == Counts(0, 1, 1)


def test_lines_are_paired_for_the_largest_sum():
    """The best single pair (0.9) would leave 0.0 for the others: 0.8 and 0.7 together are more."""
    assert counts_above(np.array([[0.9, 0.8], [0.7, 0.0]]), 0.5) == Counts(2, 0, 0)


def test_two_found_lines_do_not_share_a_true_one():
    assert culane([line(800), line(802)], [line(800)], SHAPE) == Counts(1, 1, 0)


lanes = st.lists(st.floats(0, 1280), max_size=4)


@given(lanes, lanes)
def test_scores_are_shares_and_counts_add_up(found, true):
    score = tusimple([upright(x) for x in found], [upright(x) for x in true], ROWS)
    assert all(0.0 <= value <= 1.0 for value in (score.accuracy, score.fn))
    assert score.fp <= 1.0
    tp, fp, fn = culane([line(x, 79) for x in found], [line(x, 79) for x in true], (80, 1280))
    assert (tp + fp, tp + fn) == (len(found), len(true))


@given(st.lists(st.floats(-2, 2), min_size=1, max_size=4, unique=True))
def test_identity_is_right(slopes):
    truth = [600 + slope * ROWS for slope in slopes]
    assert tusimple(truth, truth, ROWS) == TuSimpleScore(1.0, pytest.approx(0.0, abs=0), 0.0)
