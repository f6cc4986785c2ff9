"""How the public lane benchmarks score a frame: TuSimple by points at rows, CULane by drawn lines. Pure functions."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.geometry.assignment import largest_total
from roadperc_stream.model import Mask

TUSIMPLE_PX: Final = 20.0
"""Columns by which a point may be off, of a lane that stands upright in a 1280 px wide image."""
TUSIMPLE_MATCHED: Final = 0.85
"""Accuracy from which a true lane is found."""
_TUSIMPLE_SURPLUS: Final = 2
"""More predicted lanes than true ones by more than this are no answer at all."""
_TUSIMPLE_LANES: Final = 4
"""Of more true lanes than this the worst one is forgiven."""
_NOWHERE_PX: Final = -100.0
"""Column of a point that is not there, as in TuSimple's script: near to none that is, and right where both are not."""
CULANE_WIDTH_PX: Final = 30
"""Width a lane is drawn with in a 1640 px wide image."""
_TUSIMPLE_COLUMNS: Final = 1280
_CULANE_COLUMNS: Final = 1640
"""Widths of the benchmarks' images: their thresholds in px scale with the image, so that resolution does not matter."""
_SUBPIXEL_BITS: Final = 4
_DRAWABLE_PX: Final = 2.0**14
"""To points farther than this outside the image, as of a line that passes beside the camera, OpenCV draws a line that
is a few columns off; far more of them take seconds, or do not fit into its 32 bits."""


class TuSimpleScore(NamedTuple):
    """One frame's share of right points, of predicted lanes that are wrong, and of true lanes that are missed."""

    accuracy: float
    fp: float
    fn: float


class Counts(NamedTuple):
    """Lines found rightly, found wrongly and missed."""

    tp: int
    fp: int
    fn: int


def tusimple_px(columns: int) -> float:
    """``TUSIMPLE_PX`` in an image of so many columns."""
    return TUSIMPLE_PX * columns / _TUSIMPLE_COLUMNS


def culane_width_px(columns: int) -> float:
    """``CULANE_WIDTH_PX`` in an image of so many columns."""
    return CULANE_WIDTH_PX * columns / _CULANE_COLUMNS


def tusimple(
    predicted: Sequence[Float], truth: Sequence[Float], rows: Float, threshold_px: float = TUSIMPLE_PX
) -> TuSimpleScore:
    """Accuracy, false positives and false negatives of a frame, by the TuSimple lane detection challenge (2017).

    A point is right where its column is less than ``threshold_px`` / cos(angle of the true lane) off, or where neither
    lane has one; a true lane's accuracy is that of the predicted lane with most right points, and it is found at
    ``TUSIMPLE_MATCHED``. As in the benchmark's script, the worst of more than four true lanes is forgiven, and a frame
    with more than two lanes too many scores (0, 0, 1).

    Args:
        predicted: a lane each: (N,) column in px at each row, NaN where the lane has no point.
        truth: the same, true.
        rows: (N,) rows in px, the same for all lanes.
        threshold_px: 20 in the benchmark's images, 1280 px wide.

    Raises:
        ValueError: a lane has not one column per row.
    """
    for lane in (*predicted, *truth):
        if np.shape(lane) != np.shape(rows):
            raise ValueError(f"expected a column for each of {np.size(rows)} rows, got {np.size(lane)}")
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
    """Angle of the straight line fitted to a lane, from the upright, radians; 0 with fewer than two points."""
    known = np.isfinite(lane)
    if np.count_nonzero(known) < 2:
        return 0.0
    x, y = lane[known], rows[known] - rows[known].mean()
    return float(np.arctan2(y @ (x - x.mean()), y @ y))


def _best_accuracy(predicted: Sequence[Float], lane: Float, threshold_px: float) -> float:
    true_px = np.nan_to_num(lane, nan=_NOWHERE_PX)
    right = (np.abs(np.nan_to_num(other, nan=_NOWHERE_PX) - true_px) < threshold_px for other in predicted)
    return max((float(found.mean()) for found in right), default=0.0)


def line_overlaps(
    predicted: Sequence[Float], truth: Sequence[Float], shape: tuple[int, int], width_px: float = CULANE_WIDTH_PX
) -> Float:
    """(predicted, truth) intersections over union of lines drawn ``width_px`` wide, by which CULane pairs them.

    Args:
        predicted: a line each: (N, 2) x, y in px from end to end, joined by straight pieces.
        truth: the same, true.
        shape: rows and columns of the image.
        width_px: 30 in the benchmark's images, 1640 px wide.
    """
    places = [np.flatnonzero(_drawn(line, shape, width_px)) for line in predicted]  # a line fills few of the pixels
    overlaps = np.zeros((len(predicted), len(truth)))
    for k, true in enumerate(_drawn(line, shape, width_px).reshape(-1) for line in truth):
        true_area = int(np.count_nonzero(true))
        for i, place in enumerate(places):
            shared = int(np.count_nonzero(true[place]))
            overlaps[i, k] = shared / max(len(place) + true_area - shared, 1)
    return overlaps


def counts_above(overlaps: Float, threshold: float) -> Counts:
    """Lines found rightly, wrongly and missed, as CULane counts them (Pan et al., Spatial As Deep, AAAI 2018).

    Predicted and true lines are paired one to one so that their intersections over union have the largest sum, and a
    pair above the threshold is a true positive. Precision, recall and F1 of a run are computed from the counts summed
    over its frames.

    Args:
        overlaps: (predicted, truth) intersections over union, as ``line_overlaps`` gives them.
        threshold: 0.5 in the benchmark, 0.3 in its looser variant.
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
    """Polylines within ``most_px`` of the origin: an (N, 2) line, or of one that goes farther its clipped segments."""
    if (np.abs(line) <= most_px).all():
        return [line]
    starts, steps = line[:-1], np.diff(line, axis=0)
    borders = np.array([-most_px, most_px]).reshape(2, 1, 1)
    with np.errstate(divide="ignore", invalid="ignore"):  # along a border's direction: never, or NaN on the border
        crossings = np.sort((borders - starts) / steps, axis=0)
    first = np.maximum(crossings[0].max(axis=1), 0)
    last = np.minimum(crossings[1].min(axis=1), 1)
    inside = first < last
    shares = np.stack([first, last], axis=1)[inside, :, None]
    return list(starts[inside, None] + shares * steps[inside, None])
