"""The ego lane's two boundaries, and how far they are off: on the road, and as the public benchmarks score lanes."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from roadperc_stream.core.datatypes import SIDES, Absent, Boundary, Lanes
from roadperc_stream.core.geometry import Camera, Float, inverse, project, transform
from roadperc_stream.metrics import lane_scores
from roadperc_stream.schemas.columns import Columns

LANE_ERROR_AT_M: Final = 10.0
ROW_STEP_PX: Final = 10
"""TuSimple's rows are the multiples of this."""
TUSIMPLE_COLUMNS: Final = 1280
CULANE_COLUMNS: Final = 1640
"""Widths of the benchmarks' images: their thresholds in px scale with the image, so that resolution does not matter."""
CULANE_THRESHOLDS: Final = {50: 0.5, 30: 0.3}
"""Intersection over union from which a line is found, by the ending of its columns."""


def lane_columns(lanes: Lanes | Absent) -> Columns:
    """Each boundary as the chain follows it, and what both say of the lane."""
    if isinstance(lanes, Absent):
        return {}
    left, right = lanes.side("left"), lanes.side("right")
    columns: Columns = {"lane_proposals": len(lanes.proposals_px), "lane_merged": len(lanes.merged_px)}
    for boundary in (left, right):
        prefix = f"lane_{boundary.side}"
        columns[f"{prefix}_status"] = boundary.status
        columns[f"{prefix}_offset_m"] = boundary.offset_m
        columns[f"{prefix}_raw_offset_m"] = boundary.raw_offset_m
        columns[f"{prefix}_boundary_class"] = boundary.outside or None
    if left.offset_m is not None and right.offset_m is not None:
        columns["lane_width_m"] = left.offset_m - right.offset_m
    headings = [boundary.heading for boundary in (left, right) if boundary.heading is not None]
    if headings:
        columns["lane_heading_deg"] = float(np.degrees(np.mean(headings)))
    return columns


def lane_errors(lanes: Lanes | Absent, truth: Lanes | None) -> Columns:
    """How far each boundary is off on the road; nothing without truth."""
    if isinstance(lanes, Absent) or truth is None:
        return {}
    return {f"lane_{side}_error_m": lane_error_m(lanes.side(side), truth.side(side)) for side in SIDES}


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


def true_lane_columns(truth: Lanes | None) -> Columns:
    """Where the true boundaries are at the ego origin, for the smoothed ones' jitter and lag."""
    return {} if truth is None else {f"lane_{side}_true_offset_m": truth.side(side).offset_m for side in SIDES}


def lane_benchmarks(lanes: Lanes | Absent, truth: Lanes | None, camera: Camera, ego_T_camera: Float) -> Columns:
    """TuSimple's and CULane's scores of the two boundaries in the image; none where no true one is in view."""
    if isinstance(lanes, Absent) or truth is None:
        return {}
    visible = (in_view(_projected(truth.side(side), camera, ego_T_camera), camera) for side in SIDES)
    true_px = [line for line in visible if len(line)]
    if not true_px:
        return {}
    found_px = [line for side in SIDES if len(line := in_view(lanes.side(side).line_px, camera))]
    return {**_tusimple_columns(found_px, true_px, camera), **_culane_columns(found_px, true_px, camera)}


def _tusimple_columns(found_px: Sequence[Float], true_px: Sequence[Float], camera: Camera) -> Columns:
    top = min(line[:, 1].min() for line in true_px)
    rows = np.arange(np.ceil(top / ROW_STEP_PX) * ROW_STEP_PX, camera.height, ROW_STEP_PX)
    if not len(rows):
        return {}
    score = lane_scores.tusimple(
        [columns_at(line, rows, camera) for line in found_px],
        [columns_at(line, rows, camera) for line in true_px],
        rows,
        lane_scores.TUSIMPLE_PX * camera.width / TUSIMPLE_COLUMNS,
    )
    return {f"lane_tusimple_{name}": value for name, value in score._asdict().items()}


def _culane_columns(found_px: Sequence[Float], true_px: Sequence[Float], camera: Camera) -> Columns:
    width_px = lane_scores.CULANE_WIDTH_PX * camera.width / CULANE_COLUMNS
    overlaps = lane_scores.line_overlaps(found_px, true_px, camera.size, width_px)
    return {
        f"lane_culane_{name}_{percent}": value
        for percent, threshold in CULANE_THRESHOLDS.items()
        for name, value in lane_scores.counts_above(overlaps, threshold)._asdict().items()
    }


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
