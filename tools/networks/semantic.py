"""Masks of the road and its markings from a small network's scores, without the known faults of such networks.

A small network sees the image at a fraction of its size. Its markings are equally wide at every distance, its road has
holes just before the car, and it takes the own bonnet for road. The corrections need no second network.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float, Float32
from roadperc_stream.model import Mask

from .description import SegmentationKeys

_STEPS = 64.0
"""Scores are rounded to multiples of 1 / 64: other processors and versions differ by less."""
_HORIZON_FRAMES = 101
"""Frames of the running median: four seconds at 25 Hz."""
_ROAD_COLUMNS = 0.01
"""Minimum share of road columns in a row that shows the road."""

_HOLES_BELOW = (0.5, 0.2)
"""Shares of the road's rows below which holes are filled: up to two and five times the nearest row's distance."""


@dataclass(frozen=True)
class RoadMasks:
    """(H, W) pixels of the road and of its markings; a pixel of both is a marking."""

    drivable: Mask
    markings: Mask


@dataclass(frozen=True)
class HorizonEstimate:
    """The horizon's row: the running median of the topmost road row, over the last frames that show a road."""

    rows: tuple[int, ...] = ()

    def after(self, drivable: Mask) -> "HorizonEstimate":
        """The estimate after one more frame, given its (H, W) road."""
        far = np.flatnonzero(np.count_nonzero(drivable, axis=1) >= max(_ROAD_COLUMNS * drivable.shape[1], 1))
        return HorizonEstimate((*self.rows, int(far[0]))[-_HORIZON_FRAMES:]) if len(far) else self

    @property
    def row(self) -> float | None:
        """The row, pixels; None before the first road."""
        return float(np.median(self.rows)) if self.rows else None


def full_size_scores(scores: Float32, size: tuple[int, int]) -> Float32:
    """(C, H, W) scores of an image of size (H, W), from (C, h, w) ones of a network.

    Interpolating the scores before the comparison moves a class's edge by less than a pixel; the nearest score moves it
    by up to half of a network's pixel.
    """
    rounded = np.rint(scores.astype(np.float32) * _STEPS) / np.float32(_STEPS)
    return np.stack([cv2.resize(channel, size[::-1], interpolation=cv2.INTER_LINEAR) for channel in rounded])


def corrected(
    keys: SegmentationKeys, camera_height_m: float, horizon: HorizonEstimate, masks: RoadMasks, boxes_px: Float
) -> tuple[HorizonEstimate, RoadMasks]:
    """The horizon after this frame, and its corrected masks.

    ``boxes_px`` are the (N, 4) x_min, y_min, x_max, y_max of the objects in the frame.
    """
    seen = seen_mask(keys, masks.drivable.shape)
    masks = RoadMasks(masks.drivable & seen, masks.markings & seen)
    horizon = horizon.after(masks.drivable)
    if keys.marking_width_m is not None and horizon.row is not None:
        masks = with_marking_width(masks, horizon.row, keys.marking_width_m / camera_height_m)
    if keys.fill_holes:
        masks = replace(masks, drivable=without_holes(masks.drivable | masks.markings, seen, boxes_px))
    return horizon, masks


def seen_mask(keys: SegmentationKeys, size: tuple[int, ...]) -> Mask:
    """(H, W) pixels inside ``roi`` and above ``ignore_below``."""
    height, width = size
    seen = np.full(size, not keys.roi, np.uint8)
    if keys.roi:
        cv2.fillPoly(seen, [np.rint(np.array(keys.roi) * (width, height)).astype(np.int32)], 1)
    seen[round(keys.ignore_below * height) :] = 0
    return seen.view(bool)


def with_marking_width(masks: RoadMasks, horizon_row: float, width_per_row: float) -> RoadMasks:
    """The masks with each marking as wide as it is on the road: ``width_per_row`` pixels per row below the horizon.

    A line of width w appears w (row - horizon) / h pixels wide to a camera at height h, in any direction on the road.
    The middle of each run of marked pixels in a row remains. Pixels that are no longer marked become road if the pixel
    beside the run is road. Rows above the horizon have no markings.
    """
    rows, first, end = _runs(masks.markings)
    size, centre = masks.markings.shape, (first + end) // 2
    below = rows > horizon_row
    wanted = width_per_row * (rows[below] - horizon_row)
    middle = (first[below] + end[below]) / 2
    markings = _filled(rows[below], np.rint(middle - wanted / 2), np.rint(middle + wanted / 2), size)
    left = masks.drivable[rows, np.maximum(first - 1, 0)]
    right = masks.drivable[rows, np.minimum(end, size[1] - 1)]
    freed = _filled(rows[left], first[left], centre[left], size)
    freed |= _filled(rows[right], centre[right], end[right], size)
    return RoadMasks(masks.drivable | freed, markings)


def without_holes(road: Mask, seen: Mask, boxes_px: Float) -> Mask:
    """(H, W) road with its holes before the car filled, except those with a box's pixels.

    What is beside a road is above it in the image. So a hole has road above it in each column. Only holes below a share
    of the road's rows are filled: the near ones first, because a box in a far one would keep both.
    """
    boxes = np.clip(np.rint(boxes_px), 0, max(road.shape)).astype(int)
    for share in _HOLES_BELOW:
        far = np.argmax(road.any(axis=1))
        below = np.maximum.accumulate(road, axis=0)
        below[: int(far + share * (len(road) - far))] = False
        count, labels = cv2.connectedComponents((below & seen & ~road).view(np.uint8), connectivity=4)
        hole = np.arange(count) > 0
        for x_min, y_min, x_max, y_max in boxes:
            hole[labels[y_min:y_max, x_min:x_max]] = False
        road = road | hole[labels]
    return road


def _runs(mask: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Rows of (H, W) runs of set pixels, their first columns and the columns after their last ones."""
    change = np.diff(np.pad(mask.view(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, first = np.nonzero(change == 1)
    return rows, first, np.nonzero(change == -1)[1]


def _filled(
    rows: NDArray[np.intp], first: NDArray[np.generic], end: NDArray[np.generic], size: tuple[int, ...]
) -> Mask:
    """(H, W) mask with the pixels from ``first`` to before ``end`` set in each of these rows."""
    height, width = size
    steps = np.zeros((height, width + 1), np.int32)
    np.add.at(steps, (rows, np.clip(first, 0, width).astype(int)), 1)
    np.add.at(steps, (rows, np.clip(end, 0, width).astype(int)), -1)
    return np.asarray(np.cumsum(steps[:, :-1], axis=1) > 0)
