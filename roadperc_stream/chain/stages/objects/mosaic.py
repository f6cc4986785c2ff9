"""The boxes of a frame's detections: their overlaps, and their surroundings as one mosaic.

With a mosaic, each step over pixels is one call for all boxes. This is faster, because calls cost more than pixels.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.model import Box, Ids, Image, Mask
from roadperc_stream.model.changed import changed
from roadperc_stream.model.frame import Frame, mark
from roadperc_stream.model.tag_tables import classes_of_label

MARGIN = 0.25
"""Margin around a box, as a share of its sides: an object that continues there is larger than the box."""
LEAST_MARGIN_PX = 3.0
LONGEST_SIDE = 64
"""Largest number of sampled rows and columns; larger boxes are sampled at every second pixel, or every third."""
LEAST_TOGETHER = 3
"""Minimum number of pixels of the class in the 3x3 neighbourhood of a pixel that counts."""
_SMOOTHED_PX = 5
_SIGMA_DEPTH = 0.04
"""Standard deviation of the bilateral filter's weights by depth, as a share of the depth."""
_SIGMA_PX = 2.0
"""Standard deviation of its weights by position, pixels."""
_UNKNOWN_M = 1e6
BEYOND = 0.1
"""Pixels beyond the depth's range get the limit plus this share, so that they are separate from objects just before
the limit."""
Indices = NDArray[np.int64]
Pixels = tuple[slice, slice]
"""Rows and columns of an image."""
_OF_PIXELS: Final = ("inside", "tags", "of_class", "log_depth", "distances_m", "beyond", "noise", "ids")
"""Fields of (H, W) pixels."""
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Mosaic:
    """The cutouts of N boxes, one below the other with an empty row after each: (H, W) pixels.

    ``first_px`` (N, 2) are column and row of each cutout's first pixel in the image. ``steps`` (N, 2) are its sampling
    steps in columns and rows, ``tops`` (N + 1,) its first row in the mosaic. ``inside`` is 1 at pixels of the cutouts,
    ``of_class`` at those of the box's classes. ``tags`` are None without tags. ``log_depth`` is the logarithm of the
    smoothed depth in metres. ``distances_m`` is the smoothed distance from the camera, 0 where it is unknown or
    beyond the depth's range. ``beyond`` marks the latter, and is None if there are none. ``noise`` is the absolute
    difference of the logarithm before and after smoothing. These four are None without dense depth. ``ids`` are
    instance masks or None.
    """

    first_px: Indices
    steps: Indices
    tops: Indices
    inside: Image
    tags: Image | None
    of_class: Image
    log_depth: Float32 | None
    distances_m: Float32 | None
    beyond: Mask | None
    noise: Float32 | None
    ids: Ids | None


def corners(boxes: Iterable[Box]) -> Float:
    """(4, N) x_min, y_min, x_max and y_max."""
    return np.array([(b.x_min, b.y_min, b.x_max, b.y_max) for b in boxes], np.float64).reshape(-1, 4).T


def areas(of_corners: Float) -> Float:
    """(N,) square pixels of (4, N) corners."""
    x0, y0, x1, y1 = of_corners
    inside: Float = np.maximum(x1 - x0, 0.0) * np.maximum(y1 - y0, 0.0)
    return inside


def shared_areas(ours: Float, theirs: Float) -> Float:
    """(M, N) square pixels that (4, M) and (4, N) corners have in common."""
    x0, y0, x1, y1 = ours[:, :, None]
    width = np.minimum(x1, theirs[2]) - np.maximum(x0, theirs[0])
    height = np.minimum(y1, theirs[3]) - np.maximum(y0, theirs[1])
    shared: Float = np.where((width > 0) & (height > 0), width * height, 0.0)
    return shared


def overlaps(ours: Float, theirs: Float) -> Float:
    """(M, N) intersection over union of (4, M) with (4, N) corners: ``Box.overlap`` of all pairs."""
    shared = shared_areas(ours, theirs)
    union = areas(ours)[:, None] + areas(theirs) - shared
    quotients: Float = np.divide(shared, union, out=np.zeros_like(shared), where=shared > 0)
    return quotients


def kinds(*lists: Sequence[str]) -> tuple[NDArray[np.int64], ...]:
    """For each list of labels, the number of each label's kind; numbers are common to all lists.

    Labels of one kind may be the same object: detectors confuse car, van and truck.
    """
    of_label = [[classes_of_label(label) or (label,) for label in labels] for labels in lists]
    numbers = {kind: number for number, kind in enumerate(dict.fromkeys(k for kinds in of_label for k in kinds))}
    return tuple(np.array([numbers[kind] for kind in kinds], np.int64) for kinds in of_label)


def cut_out(frame: Frame, lookups: Sequence[Image | None], boxes: Sequence[Box]) -> Mosaic:
    """The mosaic of the surroundings of boxes.

    Args:
        frame: the frame; without tags, pixels count as any class.
        lookups: for each box, (256,) 1 at the tags of its classes; None if they are unknown.
        boxes: boxes in the frame's image; a box outside the image has an empty cutout.
    """
    cutouts = [_around(frame.camera, box) for box in boxes]
    heights, widths = (
        np.array([[len(range(p.start, p.stop, p.step)) for p in c] for c in cutouts], np.int64).reshape(-1, 2).T
    )
    tops = np.append(0, np.cumsum(heights + 1))
    size = int(tops[-1]), int(widths.max(initial=0))
    places = [
        (slice(top, top + height), slice(width)) for top, height, width in zip(tops, heights, widths, strict=False)
    ]
    first_px = np.array([(columns.start, rows.start) for rows, columns in cutouts], np.int64).reshape(-1, 2)
    steps = np.array([(columns.step, rows.step) for rows, columns in cutouts], np.int64).reshape(-1, 2)
    width_of_row = np.repeat(widths, heights + 1)
    width_of_row[tops[1:] - 1] = 0
    inside = (np.arange(size[1]) < width_of_row[:, None]).view(np.uint8)
    tags = None if frame.tags is None else _placed(frame.tags, cutouts, places, np.zeros(size, np.uint8))
    ids = None if frame.instances is None else _placed(frame.instances, cutouts, places, np.zeros(size, np.uint16))
    log_depth = distances = beyond = noise = None
    if frame.dense_depth_m is not None and inside.size:
        depth_m = _placed(frame.dense_depth_m, cutouts, places, np.full(size, np.nan, np.float32))
        beyond = depth_m >= np.float32(frame.depth_limit_m)
        unknown = ~(depth_m > 0)
        log_depth, noise = _smoothed(np.multiply(depth_m, np.float32(1 + BEYOND), out=depth_m, where=beyond), unknown)
        distances = _ray_lengths(frame.camera, first_px, steps, tops, size)
        distances *= np.exp(log_depth)
        distances *= ~(beyond | unknown)
        beyond = beyond if beyond.any() else None
    of_pixels = log_depth, distances, beyond, noise, ids
    return with_classes(Mosaic(first_px, steps, tops, inside, tags, inside, *of_pixels), lookups)


def with_classes(mosaic: Mosaic, lookups: Sequence[Image | None]) -> Mosaic:
    """The mosaic with the pixels of other classes; ``lookups`` as in ``cut_out``.

    Isolated pixels and pairs would join objects, so they do not count. Pixels without a class count only with instance
    masks; depth alone does not separate a car from the road.
    """
    of_class = np.full_like(mosaic.inside, mosaic.ids is not None)
    for lookup in {id(lookup): lookup for lookup in lookups}.values():
        if lookup is not None and mosaic.tags is not None and of_class.size:
            rows = np.repeat([other is lookup for other in lookups], np.diff(mosaic.tops))
            of_class[rows] = mark(mosaic.tags[rows], lookup)
    of_class &= mosaic.inside
    if of_class.size:
        around = cv2.boxFilter(of_class, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        of_class &= around >= LEAST_TOGETHER
    return changed(mosaic, of_class=of_class)


def part_of(mosaic: Mosaic, chosen: Sequence[int]) -> Mosaic:
    """The mosaic of some of the N boxes, by ascending position."""
    heights = np.diff(mosaic.tops)
    rows = np.concatenate([np.arange(*mosaic.tops[k : k + 2]) for k in chosen])
    pixels = {name: values.take(rows, axis=0) for name in _OF_PIXELS if (values := getattr(mosaic, name)) is not None}
    tops = np.append(0, np.cumsum(heights[chosen]))
    return changed(mosaic, first_px=mosaic.first_px[chosen], steps=mosaic.steps[chosen], tops=tops, **pixels)


def _around(camera: Camera, box: Box) -> Pixels:
    """Rows and columns of a box and its margin in the image; empty if the box is outside the image."""
    x0, y0, x1, y1 = box.rounded(camera.width, camera.height)
    if x0 >= x1 or y0 >= y1:
        return slice(0, 0, 1), slice(0, 0, 1)
    x_margin, y_margin = (max(MARGIN * side, LEAST_MARGIN_PX) for side in (x1 - x0, y1 - y0))
    around = Box(x0 - x_margin, y0 - y_margin, x1 + x_margin, y1 + y_margin)
    x0, y0, x1, y1 = around.rounded(camera.width, camera.height)
    return _sampled(y0, y1), _sampled(x0, x1)


def _sampled(first: int, end: int) -> slice:
    """At most ``LONGEST_SIDE`` rows or columns, evenly spaced."""
    return slice(first, end, max(-(-(end - first) // LONGEST_SIDE), 1))


def _placed(picture: NDArray[T], cutouts: Sequence[Pixels], places: Sequence[Pixels], into: NDArray[T]) -> NDArray[T]:
    for cutout, place in zip(cutouts, places, strict=True):
        into[place] = picture[cutout]
    return into


def _smoothed(depth_m: Float32, unknown: NDArray[np.bool_]) -> tuple[Float32, Float32]:
    """The smoothed logarithm of the depth, and the absolute difference to the logarithm before.

    In the logarithm, noise and jumps are shares of the depth. Unknown pixels count as far away.
    """
    log_depth = np.log(np.where(unknown | (depth_m == np.inf), np.float32(_UNKNOWN_M), depth_m))
    smoothed = np.asarray(cv2.bilateralFilter(log_depth, _SMOOTHED_PX, _SIGMA_DEPTH, _SIGMA_PX), np.float32)
    return smoothed, np.abs(log_depth - smoothed)


def _ray_lengths(camera: Camera, first_px: Indices, steps: Indices, tops: Indices, size: tuple[int, int]) -> Float32:
    """(H, W) length of each pixel's ray per metre of depth."""
    owner = np.repeat(np.arange(len(steps)), np.diff(tops))
    rows = first_px[owner, 1] + steps[owner, 1] * (np.arange(size[0]) - tops[owner])
    x = (first_px[:, :1] + steps[:, :1] * np.arange(size[1]) - camera.cx) / camera.fx
    y = (rows - camera.cy) / camera.fy
    lengths: Float32 = np.sqrt((x**2 + 1.0).astype(np.float32)[owner] + (y**2).astype(np.float32)[:, None])
    return lengths


def boxes_of(mosaic: Mosaic, owners: Indices, bounds: Indices) -> Float:
    """(4, K) corners in the image of regions with corners (4, K) in the mosaic; ``owners`` are their cutouts."""
    x0, y0, x1, y1 = bounds
    x_step, y_step = mosaic.steps[owners].T
    left, top = mosaic.first_px[owners].T
    tops = mosaic.tops[owners]
    places = (left + x_step * x0, top + y_step * (y0 - tops), left + x_step * x1, top + y_step * (y1 - tops))
    return np.array(places, np.float64)
