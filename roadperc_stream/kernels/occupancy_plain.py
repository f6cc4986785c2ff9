"""The function of ``occupancy_compiled`` in numpy; only the compiled one checks sizes (ValueError)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]
Counts = NDArray[np.int64]


class Rays(NamedTuple):
    """The rays of an image's pixels: the sum of ``column`` (3, W) and ``row`` (3, H), from ``start_m`` (3,)."""

    column: Float32
    row: Float32
    start_m: Float32


@dataclass(frozen=True)
class Cells:
    """A grid from x and y on, the length of its cells, and the heights of obstacles; metres, compared in float32."""

    x_min: float
    y_min: float
    resolution: float
    min_height: float
    max_height: float


class KnownPixels(NamedTuple):
    """An image's pixels, each (H, W): depth (NaN unknown), height above the road, 0 or 1 for drivable, and tags.

    Without ``height_m`` heights are computed above the road's plane. ``obstacle_tags`` is (256,) 1 at tags of
    obstacles, else 0.
    """

    depth_m: Float32
    height_m: Float32 | None
    drivable: Marks
    tags: Marks
    obstacle_tags: Marks


def count_points(cells: Cells, pixels: KnownPixels, rays: Rays, abd: Float32, free: Counts, occupied: Counts) -> None:
    """Add the pixels' points to (rows along y, columns along x) counts of each cell, in place.

    ``free`` counts drivable points of known height. ``occupied`` counts points from ``min_height`` up or of an obstacle
    class, but at most ``max_height`` high. A point may count in both. ``abd`` (3,) is the road as a x + b y + z = d.
    """
    depth_m, height_m, drivable, tags, obstacle_tags = pixels
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = ((rays.row[k, :, None] + rays.column[k]) * depth_m + rays.start_m[k] for k in range(3))
        height = z - (abd[2] - abd[0] * x - abd[1] * y) if height_m is None else height_m
        high = height >= np.float32(cells.min_height)
        obstacle = (high | obstacle_tags[tags].view(bool)) & (height <= np.float32(cells.max_height))
    on_road = drivable.view(bool) & np.isfinite(height)
    free += _counts(cells, x[on_road], y[on_road], free.shape)
    occupied += _counts(cells, x[obstacle], y[obstacle], free.shape)


def _counts(cells: Cells, x: Float32, y: Float32, shape: tuple[int, ...]) -> Counts:
    """The number of (N,) points in each cell."""
    rows, columns = shape
    with np.errstate(invalid="ignore", over="ignore"):
        i = np.floor((x - np.float32(cells.x_min)) / np.float32(cells.resolution))
        j = np.floor((y - np.float32(cells.y_min)) / np.float32(cells.resolution))
        inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    place = j[inside].astype(np.int64) * columns + i[inside].astype(np.int64)
    counts: Counts = np.bincount(place, minlength=rows * columns)
    return counts.reshape(rows, columns)
