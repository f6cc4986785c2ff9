"""The two boundaries against truth, on the road and in the image, with answers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.geometry import inverse, project, transform
from roadperc_stream.metrics.lanes import columns_at, lane_benchmarks, lane_error_m, true_lane_columns
from roadperc_stream.model import Absent, Boundary, Lanes, Reason
from roadperc_stream.schemas.columns.errors import LaneScoreColumns, TrueLaneColumns
from tests.analytic import Road
from tests.metrics.frames import boundary

ROAD = Road(width=1280, height=720)
COUNTS = [f"lane_culane_{name}_{percent}" for percent in (50, 30) for name in ("tp", "fp", "fn")]


def test_lane_error_is_taken_ten_metres_ahead():
    assert lane_error_m(boundary(1.8, 0.01), boundary(1.8)) == pytest.approx(0.1)
    assert lane_error_m(boundary(1.55), boundary(1.8)) == pytest.approx(-0.25)
    assert lane_error_m(boundary(1.8), boundary(1.8)) == 0.0


def test_lane_error_needs_both():
    assert lane_error_m(Boundary("left", "lost"), boundary(1.8)) is None
    assert lane_error_m(boundary(1.8), Boundary("left", "measured")) is None


def seen(true, right_px=0.0):
    """A boundary that is seen where the true one is, so many columns to the right."""
    line_px = project(ROAD.camera, transform(inverse(ROAD.ego_T_camera), true.line_ego_m[1:]))
    return replace(true, line_px=line_px + np.array([right_px, 0.0]))


TRUTH = Lanes((boundary(1.8), boundary(-1.9, side="right")))


def scored(left_px, right_px):
    found = Lanes((seen(TRUTH.side("left"), left_px), seen(TRUTH.side("right"), right_px)))
    columns = lane_benchmarks(found, TRUTH, ROAD.camera, ROAD.ego_T_camera)
    return [getattr(columns, f"lane_tusimple_{name}") for name in ("accuracy", "fp", "fn")], [
        getattr(columns, name) for name in COUNTS
    ]


def test_the_true_boundaries_score_full():
    assert scored(0, 0) == ([1.0, 0.0, 0.0], [2, 0, 0, 2, 0, 0])


def test_a_boundary_moved_by_a_tenth_of_the_image_is_found_wrongly_and_missed():
    tusimple, counts = scored(128, 0)
    assert tusimple == [0.5, 0.5, 0.5]
    assert counts == [1, 1, 1, 1, 1, 1]


def test_thresholds_grow_with_the_image():
    """Half the size, half the shift: the same score."""
    small = replace(ROAD, width=640, height=360)
    for shift_px, right in ((20, True), (40, False)):
        for road, px in ((ROAD, shift_px), (small, shift_px / 2)):
            steep = Lanes((boundary(0.1),))
            line_px = project(road.camera, transform(inverse(road.ego_T_camera), steep.side("left").line_ego_m[1:]))
            found = Lanes((replace(steep.side("left"), line_px=line_px + np.array([0.9 * px, 0.0])),))
            score = lane_benchmarks(found, steep, road.camera, road.ego_T_camera)
            assert (score.lane_tusimple_fn == 0) is right, (shift_px, road.width)


NOTHING = Absent(Reason("lanes", "not_run"))


@pytest.mark.parametrize("scale", [1, 2])
def test_drawn_lines_grow_with_the_image(scale):
    """23 px wide in 1280, moved by 10: 13 of 33 columns are shared, 0.39."""
    road = replace(ROAD, width=1280 // scale, height=720 // scale)
    true = boundary(0.1)
    line_px = project(road.camera, transform(inverse(road.ego_T_camera), true.line_ego_m[1:]))
    found = Lanes((replace(true, line_px=line_px + np.array([10.0 / scale, 0.0])),))
    score = lane_benchmarks(found, Lanes((true,)), road.camera, road.ego_T_camera)
    assert (score.lane_culane_tp_50, score.lane_culane_tp_30) == (0, 1)


def test_lost_boundaries_are_missed_and_nothing_is_found_wrongly():
    lost = Lanes((Boundary("left", "lost"), Boundary("right", "lost")))
    columns = lane_benchmarks(lost, TRUTH, ROAD.camera, ROAD.ego_T_camera)
    assert [getattr(columns, f"lane_tusimple_{name}") for name in ("accuracy", "fp", "fn")] == [0.0, 0.0, 1.0]
    assert [getattr(columns, name) for name in COUNTS] == [0, 0, 2, 0, 0, 2]


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
    near = line[1:11]
    line_px = project(ROAD.camera, transform(inverse(ROAD.ego_T_camera), near))
    found = Lanes((replace(hill.side("left"), line_px=line_px),))
    columns = lane_benchmarks(found, hill, ROAD.camera, ROAD.ego_T_camera)
    assert (columns.lane_tusimple_accuracy, columns.lane_culane_tp_50) == (1.0, 1)


def test_columns_at_rows():
    line_px = np.array([(100.0, 700.0), (200.0, 600.0), (1400.0, 500.0)])
    found = columns_at(line_px, np.array([590.0, 650.0, 710.0, 505.0]), ROAD.camera)
    np.testing.assert_allclose(found, [320.0, 150.0, np.nan, np.nan])


def test_true_offsets_are_those_of_the_truth():
    assert true_lane_columns(NOTHING, TRUTH) == TrueLaneColumns(1.8, -1.9)
    assert true_lane_columns(NOTHING, None) == TrueLaneColumns()


@pytest.mark.parametrize(
    ("lost", "expected"), [((), 2.0), (("left",), 3.0), (("right",), 1.0), (("left", "right"), None)]
)
def test_the_true_heading_is_that_of_the_boundaries_that_are_found(lost, expected):
    truth = Lanes((boundary(1.8, np.radians(1.0)), boundary(-1.9, np.radians(3.0), side="right")))
    found = Lanes(tuple(Boundary(b.side, "lost") if b.side in lost else b for b in TRUTH.boundaries))
    assert true_lane_columns(found, truth).lane_true_heading_deg == (expected and pytest.approx(expected))


def test_without_one_of_the_true_headings_there_is_none():
    truth = Lanes((TRUTH.side("left"), replace(TRUTH.side("right"), heading=None)))
    assert true_lane_columns(TRUTH, truth).lane_true_heading_deg is None
