"""The functions of ``occupancy_compiled`` in numpy; only the compiled ones check sizes (ValueError)."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.kernels.odometry_plain import Projection

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]
Counts = NDArray[np.int64]
Float = NDArray[np.float64]
_MOST: Final = 5
"""Number of pixels that are most of a pixel and its eight neighbours."""
_NEIGHBOURS: Final = np.arange(-1, 2)[:, None]
_NEAREST_M: Final = 1e-6


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


class Middles(NamedTuple):
    """The middles of a grid's cells, ego frame: ``x_m`` (C,), ``y_m`` (R,), and the road's height ``z_m`` (R, C)."""

    x_m: Float
    y_m: Float
    z_m: Float


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


def mark_visible(
    projection: Projection,
    camera_T_ego: Float,
    middles: Middles,
    drivable: NDArray[np.uint8],
    depth_m: NDArray[np.float32] | None,
    within: tuple[float, float],
) -> NDArray[np.uint8]:
    """(R, C) 1 at cells whose middle projects to a drivable pixel, else 0.

    A pixel counts as drivable if most of its 3x3 square are in ``drivable`` (H, W), 0 or 1; single pixels do not
    matter. The image's edge is repeated beyond it. With ``depth_m`` (H, W) the depth must agree with the cell's
    distance, to a share of it and metres (``within``); NaN never agrees. ``camera_T_ego`` is (4, 4).
    """
    x_m, y_m, z_m = middles
    tolerance, slack_m = within
    fx, fy, cx, cy = projection
    height, width = drivable.shape
    right, down, ahead = (T[0] * x_m + T[1] * y_m[:, None] + T[2] * z_m + T[3] for T in camera_T_ego[:3])
    with np.errstate(all="ignore"):  # points behind the camera do not count
        columns, rows = np.rint(fx * right / ahead + cx), np.rint(fy * down / ahead + cy)
        inside = (ahead > _NEAREST_M) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    v, u, ahead = rows[inside].astype(np.intp), columns[inside].astype(np.intp), ahead[inside]
    near_v, near_u = (np.clip(at + _NEIGHBOURS, 0, size - 1) for at, size in ((v, height), (u, width)))
    seen = drivable[near_v[:, None], near_u].sum(axis=(0, 1)) >= _MOST
    if depth_m is not None:
        with np.errstate(invalid="ignore"):
            seen &= np.abs(depth_m[v, u] - ahead) <= tolerance * ahead + slack_m
    visible = np.zeros(z_m.shape, np.uint8)
    visible[inside] = seen
    return visible
