"""The ego lane's two boundaries, and how far they are off: on the road, and as the public benchmarks score lanes."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from roadperc_stream.geometry import Camera, Float, inverse, project, transform
from roadperc_stream.metrics import lane_scores
from roadperc_stream.model import SIDES, Absent, Boundary, Lanes
from roadperc_stream.schemas.columns.errors import LaneErrorColumns, LaneScoreColumns, TrueLaneColumns
from roadperc_stream.schemas.columns.estimates import LaneColumns

LANE_ERROR_AT_M: Final = 10.0
ROW_STEP_PX: Final = 10
"""TuSimple's rows are the multiples of this."""
CULANE_THRESHOLDS: Final = (0.5, 0.3)
"""Intersection over union from which a line is found."""


def lane_columns(lanes: Lanes | Absent) -> LaneColumns:
    """Each boundary as the chain tracks it, and what both say of the lane."""
    if isinstance(lanes, Absent):
        return LaneColumns()
    left, right = lanes.side("left"), lanes.side("right")
    width_m = None if left.offset_m is None or right.offset_m is None else left.offset_m - right.offset_m
    headings = [boundary.heading for boundary in (left, right) if boundary.heading is not None]
    return LaneColumns(
        lane_left_status=left.status,
        lane_left_offset_m=left.offset_m,
        lane_left_raw_offset_m=left.raw_offset_m,
        lane_left_boundary_class=left.outside or None,
        lane_right_status=right.status,
        lane_right_offset_m=right.offset_m,
        lane_right_raw_offset_m=right.raw_offset_m,
        lane_right_boundary_class=right.outside or None,
        lane_width_m=width_m,
        lane_heading_deg=float(np.degrees(np.mean(headings))) if headings else None,
        lane_left_offset_std_m=_offset_std_m(left),
        lane_right_offset_std_m=_offset_std_m(right),
        lane_heading_std_deg=_heading_std_deg(left, right),
        lane_change=lanes.lane_change,
        lane_changes=lanes.lane_changes,
        lane_proposals=len(lanes.proposals_px),
        lane_merged=len(lanes.merged_px),
    )


def _offset_std_m(boundary: Boundary) -> float | None:
    return float(np.sqrt(boundary.covariance[0])) if boundary.covariance else None


def _heading_std_deg(*boundaries: Boundary) -> float | None:
    """Of the mean of headings that err independently."""
    variances = [boundary.covariance[4] for boundary in boundaries if boundary.covariance]
    return float(np.degrees(np.sqrt(sum(variances)) / len(variances))) if variances else None


def lane_errors(lanes: Lanes | Absent, truth: Lanes | None) -> LaneErrorColumns:
    """How far each boundary is off on the road; nothing without truth."""
    if isinstance(lanes, Absent) or truth is None:
        return LaneErrorColumns()
    return LaneErrorColumns(
        lane_left_error_m=lane_error_m(lanes.side("left"), truth.side("left")),
        lane_right_error_m=lane_error_m(lanes.side("right"), truth.side("right")),
    )


def lane_error_m(boundary: Boundary, truth: Boundary) -> float | None:
    """Lateral error ``LANE_ERROR_AT_M`` ahead (ego x), metres; positive where the estimate lies farther left."""
    x = LANE_ERROR_AT_M
    line = truth.line_ego_m
    if boundary.offset_m is None or boundary.heading is None or boundary.curvature_per_m is None:
        return None
    if len(line) < 2 or not line[0, 0] <= x <= line[-1, 0]:
        return None
    y = boundary.offset_m + boundary.heading * x + 0.5 * boundary.curvature_per_m * x**2
    return float(y - np.interp(x, line[:, 0], line[:, 1]))


def true_lane_columns(lanes: Lanes | Absent, truth: Lanes | None) -> TrueLaneColumns:
    """Where the true boundaries are at the ego origin, for the smoothed ones' jitter and lag, and their heading."""
    if truth is None:
        return TrueLaneColumns()
    offsets = truth.side("left").offset_m, truth.side("right").offset_m
    return TrueLaneColumns(*offsets, truth.lane_change, truth.lane_changes, _true_heading_deg(lanes, truth))


def _true_heading_deg(lanes: Lanes | Absent, truth: Lanes) -> float | None:
    """The mean true heading of the boundaries whose mean heading the row has; in a bend the two sides differ."""
    if isinstance(lanes, Absent):
        return None
    headings = [truth.side(side).heading for side in SIDES if lanes.side(side).heading is not None]
    known = [heading for heading in headings if heading is not None]
    return float(np.degrees(np.mean(known))) if known and len(known) == len(headings) else None


def lane_benchmarks(
    lanes: Lanes | Absent, truth: Lanes | None, camera: Camera, ego_T_camera: Float
) -> LaneScoreColumns:
    """TuSimple's and CULane's scores of the two boundaries in the image; none where no true one is in view."""
    if isinstance(lanes, Absent) or truth is None:
        return LaneScoreColumns()
    visible = (in_view(_projected(truth.side(side), camera, ego_T_camera), camera) for side in SIDES)
    true_px = [line for line in visible if len(line)]
    if not true_px:
        return LaneScoreColumns()
    found_px = [line for side in SIDES if len(line := in_view(lanes.side(side).line_px, camera))]
    points = _tusimple(found_px, true_px, camera)
    overlaps = _culane_overlaps(found_px, true_px, camera)
    at_50, at_30 = (lane_scores.counts_above(overlaps, threshold) for threshold in CULANE_THRESHOLDS)
    return LaneScoreColumns(
        lane_tusimple_accuracy=None if points is None else points.accuracy,
        lane_tusimple_fp=None if points is None else points.fp,
        lane_tusimple_fn=None if points is None else points.fn,
        lane_culane_tp_50=at_50.tp,
        lane_culane_fp_50=at_50.fp,
        lane_culane_fn_50=at_50.fn,
        lane_culane_tp_30=at_30.tp,
        lane_culane_fp_30=at_30.fp,
        lane_culane_fn_30=at_30.fn,
    )


def _tusimple(found_px: Sequence[Float], true_px: Sequence[Float], camera: Camera) -> lane_scores.TuSimpleScore | None:
    top = min(line[:, 1].min() for line in true_px)
    rows = np.arange(np.ceil(top / ROW_STEP_PX) * ROW_STEP_PX, camera.height, ROW_STEP_PX)
    if not len(rows):
        return None
    return lane_scores.tusimple(
        [columns_at(line, rows, camera) for line in found_px],
        [columns_at(line, rows, camera) for line in true_px],
        rows,
        lane_scores.tusimple_px(camera.width),
    )


def _culane_overlaps(found_px: Sequence[Float], true_px: Sequence[Float], camera: Camera) -> Float:
    return lane_scores.line_overlaps(found_px, true_px, camera.size, lane_scores.culane_width_px(camera.width))


def columns_at(line_px: Float, rows: Float, camera: Camera) -> Float:
    """(R,) column of an (N, 2) line, near end first, at each of (R,) rows; NaN where it is not in the image."""
    rising = line_px[::-1]
    columns: Float = np.interp(rows, rising[:, 1], rising[:, 0], left=np.nan, right=np.nan)
    columns[(columns < 0) | (columns > camera.width - 1)] = np.nan
    return columns


def _projected(boundary: Boundary, camera: Camera, ego_T_camera: Float) -> Float:
    """(N, 2) pixels of a boundary's line on the road, those before the camera."""
    line_px = project(camera, transform(inverse(ego_T_camera), boundary.line_ego_m))
    return line_px[np.isfinite(line_px).all(axis=1)]


def in_view(line_px: Float, camera: Camera) -> Float:
    """The part of an (N, 2) line, near end first, up to where a crest hides it; empty where none is in the image."""
    highest = np.minimum.accumulate(line_px[:, 1])
    seen = line_px[np.append(True, line_px[1:, 1] < highest[:-1])] if len(line_px) else line_px
    inside = ((seen >= 0) & (seen <= (camera.width - 1, camera.height - 1))).all(axis=1)
    return seen if np.count_nonzero(inside) > 1 else seen[:0]
