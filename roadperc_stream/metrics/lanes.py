"""Metrics of the ego lane's two boundaries: errors on the road, and the scores of public lane benchmarks."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np

from roadperc_stream.geometry import Camera, Float, inverse, project, transform
from roadperc_stream.geometry.assignment import largest_total
from roadperc_stream.model import SIDES, Absent, Boundary, Lanes, Mask
from roadperc_stream.schemas.columns.errors import LaneErrorColumns, LaneScoreColumns, TrueLaneColumns
from roadperc_stream.schemas.columns.estimates import LaneColumns

LANE_ERROR_AT_M: Final = 10.0
ROW_STEP_PX: Final = 10
"""TuSimple scores rows at multiples of this."""
CULANE_THRESHOLDS: Final = (0.5, 0.3)
"""Intersection over union from which a line is found."""
TUSIMPLE_PX: Final = 20.0
"""Limit of the column error of a correct point on an upright lane, in a 1280 px wide image."""
TUSIMPLE_MATCHED: Final = 0.85
"""Accuracy from which a true lane is found."""
_TUSIMPLE_SURPLUS: Final = 2
"""A frame with more surplus predicted lanes than this scores (0, 0, 1)."""
_TUSIMPLE_LANES: Final = 4
"""If there are more true lanes than this, the worst one does not count."""
_NOWHERE_PX: Final = -100.0
"""Column of an absent point, as in TuSimple's script: correct only if both points are absent."""
CULANE_WIDTH_PX: Final = 30
"""Width of a drawn lane in a 1640 px wide image."""
TUSIMPLE_COLUMNS: Final = 1280
CULANE_COLUMNS: Final = 1640
"""Widths of the benchmarks' images; thresholds in px scale with the image width."""
_SUBPIXEL_BITS: Final = 4
_DRAWABLE_PX: Final = 2.0**14
"""Farthest drawn point outside the image. Beyond it OpenCV's lines are a few columns off; much farther points take
seconds or overflow its 32 bits. Lines that pass beside the camera have such points."""


class TuSimpleScore(NamedTuple):
    """Shares of one frame: correct points, wrong predicted lanes, missed true lanes."""

    accuracy: float
    fp: float
    fn: float


class Counts(NamedTuple):
    """True positive, false positive and missed lines."""

    tp: int
    fp: int
    fn: int


def lane_columns(lanes: Lanes | Absent) -> LaneColumns:
    """The columns of each tracked boundary and of the lane between them."""
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
    """Standard deviation of the mean heading, for independent errors."""
    variances = [boundary.covariance[4] for boundary in boundaries if boundary.covariance]
    return float(np.degrees(np.sqrt(sum(variances)) / len(variances))) if variances else None


def lane_errors(lanes: Lanes | Absent, truth: Lanes | None) -> LaneErrorColumns:
    """The error of each boundary on the road; empty columns without truth."""
    if isinstance(lanes, Absent) or truth is None:
        return LaneErrorColumns()
    return LaneErrorColumns(
        lane_left_error_m=lane_error_m(lanes.side("left"), truth.side("left")),
        lane_right_error_m=lane_error_m(lanes.side("right"), truth.side("right")),
    )


def lane_error_m(boundary: Boundary, truth: Boundary) -> float | None:
    """Lateral error ``LANE_ERROR_AT_M`` ahead (ego x), metres; positive if the estimate lies farther left."""
    x = LANE_ERROR_AT_M
    line = truth.line_ego_m
    if boundary.offset_m is None or boundary.heading is None or boundary.curvature_per_m is None:
        return None
    if len(line) < 2 or not line[0, 0] <= x <= line[-1, 0]:
        return None
    y = boundary.offset_m + boundary.heading * x + 0.5 * boundary.curvature_per_m * x**2
    return float(y - np.interp(x, line[:, 0], line[:, 1]))


def true_lane_columns(lanes: Lanes | Absent, truth: Lanes | None) -> TrueLaneColumns:
    """Offsets of the true boundaries at the ego origin, for jitter and lag, their heading, and the classes beyond."""
    if truth is None:
        return TrueLaneColumns()
    left, right = truth.side("left"), truth.side("right")
    return TrueLaneColumns(
        left.offset_m,
        right.offset_m,
        truth.lane_change,
        truth.lane_changes,
        _true_heading_deg(lanes, truth),
        left.outside or None,
        right.outside or None,
    )


def _true_heading_deg(lanes: Lanes | Absent, truth: Lanes) -> float | None:
    """Mean true heading of the boundaries in the row's mean heading; in a bend the two sides differ."""
    if isinstance(lanes, Absent):
        return None
    headings = [truth.side(side).heading for side in SIDES if lanes.side(side).heading is not None]
    known = [heading for heading in headings if heading is not None]
    return float(np.degrees(np.mean(known))) if known and len(known) == len(headings) else None


def lane_benchmarks(
    lanes: Lanes | Absent, truth: Lanes | None, camera: Camera, ego_T_camera: Float
) -> LaneScoreColumns:
    """TuSimple's and CULane's scores of the two boundaries; empty columns if no true boundary is in view."""
    if isinstance(lanes, Absent) or truth is None:
        return LaneScoreColumns()
    visible = (in_view(_projected(truth.side(side), camera, ego_T_camera), camera) for side in SIDES)
    true_px = [line for line in visible if len(line)]
    if not true_px:
        return LaneScoreColumns()
    found_px = [line for side in SIDES if len(line := in_view(lanes.side(side).line_px, camera))]
    top = min(line[:, 1].min() for line in true_px)
    rows = np.arange(np.ceil(top / ROW_STEP_PX) * ROW_STEP_PX, camera.height, ROW_STEP_PX)
    points: tuple[float | None, float | None, float | None] = (None, None, None)
    if len(rows):
        found, true = ([columns_at(line, rows, camera) for line in lines] for lines in (found_px, true_px))
        points = tusimple(found, true, rows, camera.width)
    overlaps = line_overlaps(found_px, true_px, camera.size)
    at_50, at_30 = (counts_above(overlaps, threshold) for threshold in CULANE_THRESHOLDS)
    return LaneScoreColumns(*points, *at_50, *at_30)


def columns_at(line_px: Float, rows: Float, camera: Camera) -> Float:
    """(R,) column of an (N, 2) line, near end first, at each of (R,) rows; NaN outside the image."""
    rising = line_px[::-1]
    columns: Float = np.interp(rows, rising[:, 1], rising[:, 0], left=np.nan, right=np.nan)
    columns[(columns < 0) | (columns > camera.width - 1)] = np.nan
    return columns


def _projected(boundary: Boundary, camera: Camera, ego_T_camera: Float) -> Float:
    """(N, 2) pixels of the points of a boundary's line in front of the camera."""
    line_px = project(camera, transform(inverse(ego_T_camera), boundary.line_ego_m))
    return line_px[np.isfinite(line_px).all(axis=1)]


def in_view(line_px: Float, camera: Camera) -> Float:
    """The visible part of an (N, 2) line, near end first, in front of any crest; empty if outside the image."""
    highest = np.minimum.accumulate(line_px[:, 1])
    seen = line_px[np.append(True, line_px[1:, 1] < highest[:-1])] if len(line_px) else line_px
    inside = ((seen >= 0) & (seen <= (camera.width - 1, camera.height - 1))).all(axis=1)
    return seen if np.count_nonzero(inside) > 1 else seen[:0]


def tusimple(
    predicted: Sequence[Float], truth: Sequence[Float], rows: Float, columns: int = TUSIMPLE_COLUMNS
) -> TuSimpleScore:
    """Accuracy, false positives and false negatives of a frame, by the TuSimple lane detection challenge (2017).

    A point is correct if its column error is less than 20 px / cos(angle of the true lane), or if both lanes have no
    point there. The best predicted lane gives the accuracy of a true lane, which is found from ``TUSIMPLE_MATCHED`` on.
    As in the benchmark's script, the worst of more than four true lanes does not count. A frame with more than two
    surplus lanes scores (0, 0, 1). ``predicted`` and ``truth`` have an (N,) array for each lane: its column in px at
    each of the (N,) ``rows``, NaN without a point. ``columns`` is the width of the image; the 20 px of the benchmark
    scale with it.
    """
    threshold_px = TUSIMPLE_PX * columns / TUSIMPLE_COLUMNS
    if len(predicted) > len(truth) + _TUSIMPLE_SURPLUS:
        return TuSimpleScore(0.0, 0.0, 1.0)
    best = [_best_accuracy(predicted, lane, threshold_px / np.cos(lane_angle(lane, rows))) for lane in truth]
    found = sum(accuracy >= TUSIMPLE_MATCHED for accuracy in best)
    forgiven = len(truth) > _TUSIMPLE_LANES
    missed = len(truth) - found
    scored = max(min(len(truth), _TUSIMPLE_LANES), 1)
    return TuSimpleScore(
        (sum(best) - (min(best) if forgiven else 0.0)) / scored,
        (len(predicted) - found) / len(predicted) if predicted else 0.0,
        (missed - (1 if forgiven and missed else 0)) / scored,
    )


def lane_angle(lane: Float, rows: Float) -> float:
    """Angle between the line fitted to a lane and the vertical, radians; 0 with fewer than two points."""
    known = np.isfinite(lane)
    if np.count_nonzero(known) < 2:
        return 0.0
    x, y = lane[known], rows[known] - rows[known].mean()
    return float(np.arctan2(y @ (x - x.mean()), y @ y))


def _best_accuracy(predicted: Sequence[Float], lane: Float, threshold_px: float) -> float:
    true_px = np.nan_to_num(lane, nan=_NOWHERE_PX)
    right = (np.abs(np.nan_to_num(other, nan=_NOWHERE_PX) - true_px) < threshold_px for other in predicted)
    return max((float(found.mean()) for found in right), default=0.0)


def line_overlaps(predicted: Sequence[Float], truth: Sequence[Float], shape: tuple[int, int]) -> Float:
    """(predicted, truth) intersections over union of drawn lines, as CULane pairs them.

    A line is an (N, 2) polyline of x, y in px. It is drawn 30 px wide in a 1640 px wide image; the width scales with
    the image. ``shape`` is rows and columns.
    """
    width_px = CULANE_WIDTH_PX * shape[1] / CULANE_COLUMNS
    places = [np.flatnonzero(_drawn(line, shape, width_px)) for line in predicted]  # few pixels belong to a line
    overlaps = np.zeros((len(predicted), len(truth)))
    for k, true in enumerate(_drawn(line, shape, width_px).reshape(-1) for line in truth):
        true_area = int(np.count_nonzero(true))
        for i, place in enumerate(places):
            shared = int(np.count_nonzero(true[place]))
            overlaps[i, k] = shared / max(len(place) + true_area - shared, 1)
    return overlaps


def counts_above(overlaps: Float, threshold: float) -> Counts:
    """True positive, false positive and missed lines, as CULane counts them (Pan et al., Spatial As Deep, AAAI 2018).

    One-to-one pairs of predicted and true lines maximise the sum of their ``line_overlaps``. A pair above the threshold
    is a true positive. The threshold is 0.5 in the benchmark, 0.3 in its looser variant. Precision, recall and F1 of a
    replay come from the counts summed over its frames.
    """
    tp = sum(float(overlaps[pair]) > threshold for pair in largest_total(overlaps).items())
    return Counts(tp, overlaps.shape[0] - tp, overlaps.shape[1] - tp)


def _drawn(line: Float, shape: tuple[int, int], width_px: float) -> Mask:
    image = np.zeros(shape, np.uint8)
    for piece in _drawable(np.asarray(line, float), max(shape) + _DRAWABLE_PX):
        points = np.rint(piece * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.polylines(image, [points], False, 1, max(round(width_px), 1), cv2.LINE_8, _SUBPIXEL_BITS)
    return image.view(np.bool_)


def _drawable(line: Float, most_px: float) -> Sequence[Float]:
    """The polylines of an (N, 2) line within ``most_px`` of the origin: itself, or its clipped segments."""
    if (np.abs(line) <= most_px).all():
        return [line]
    starts, steps = line[:-1], np.diff(line, axis=0)
    borders = np.array([-most_px, most_px]).reshape(2, 1, 1)
    with np.errstate(divide="ignore", invalid="ignore"):  # segments parallel to a border give infinity or NaN
        crossings = np.sort((borders - starts) / steps, axis=0)
    first = np.maximum(crossings[0].max(axis=1), 0)
    last = np.minimum(crossings[1].min(axis=1), 1)
    inside = first < last
    shares = np.stack([first, last], axis=1)[inside, :, None]
    return list(starts[inside, None] + shares * steps[inside, None])
