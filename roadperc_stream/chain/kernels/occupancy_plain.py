"""What ``occupancy_compiled`` does, in numpy; the compiled form alone checks the sizes."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.kernels.odometry_plain import Projection

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]
Counts = NDArray[np.int64]
Float = NDArray[np.float64]
_MOST: Final = 5
"""Of a pixel and its eight neighbours."""
_BESIDE: Final = np.arange(-1, 2)[:, None]
_NEAREST_M: Final = 1e-6


class Rays(NamedTuple):
    """The rays of an image's pixels, whose coordinates are parts of the column and the row.

    ``column`` is (3, W), ``row`` (3, H); ``start_m`` (3,) is where they begin.
    """

    column: Float32
    row: Float32
    start_m: Float32


@dataclass(frozen=True)
class Cells:
    """A grid whose first cell begins at x and y, of so long cells; and which heights of points stand in the way.

    All metres. Points are numbers of single precision, and so are what they are compared with.
    """

    x_min: float
    y_min: float
    resolution: float
    min_height: float
    max_height: float


class KnownPixels(NamedTuple):
    """What is known of an image's pixels.

    ``depth_m`` is (H, W), NaN where no point is; ``height_m`` (H, W) over a road that is no plane, NaN where it is not
    known, None: over the plane; ``drivable`` (H, W) 0 or 1; ``tags`` (H, W) of their classes; ``obstacle_tags`` (256,)
    1 of tags of an obstacle, else 0.
    """

    depth_m: Float32
    height_m: Float32 | None
    drivable: Marks
    tags: Marks
    obstacle_tags: Marks


class Middles(NamedTuple):
    """Of a grid's cells, ego frame: ``x_m`` (C,) of columns, ``y_m`` (R,) of rows, the road's ``z_m`` (R, C)."""

    x_m: Float
    y_m: Float
    z_m: Float


def count_points(cells: Cells, pixels: KnownPixels, rays: Rays, abd: Float32, free: Counts, occupied: Counts) -> None:
    """Add to each cell its drivable points of known height, and its points that stand in the way.

    In the way are points that are high enough, or of an obstacle, and not so high that one passes below. A point may
    be both.

    Args:
        cells: the grid.
        pixels: of which points are made.
        rays: of the pixels.
        abd: (3,) the road as a x + b y + z = d.
        free: (rows along y, columns along x), changed.
        occupied: likewise.
    """
    depth_m, height_m, drivable, tags, obstacle_tags = pixels
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = ((rays.row[k, :, None] + rays.column[k]) * depth_m + rays.start_m[k] for k in range(3))
        height = z - (abd[2] - abd[0] * x - abd[1] * y) if height_m is None else height_m
        high = height >= np.float32(cells.min_height)
        in_the_way = (high | obstacle_tags[tags].view(bool)) & (height <= np.float32(cells.max_height))
    on_road = drivable.view(bool) & np.isfinite(height)
    free += _counts(cells, x[on_road], y[on_road], free.shape)
    occupied += _counts(cells, x[in_the_way], y[in_the_way], free.shape)


def _counts(cells: Cells, x: Float32, y: Float32, shape: tuple[int, ...]) -> Counts:
    """How many of (N,) points lie in each cell."""
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
    """(R, C) 1 at cells whose middle is visible as drivable, at its own distance where the depth is dense, else 0.

    A pixel counts as drivable where most of it and its eight neighbours are: a single one among others shows nothing,
    a single hole among drivable ones hides nothing. Beyond the image lies what is at its edge.

    Args:
        projection: of the camera.
        camera_T_ego: (4, 4).
        middles: of the cells.
        drivable: (H, W) 0 or 1.
        depth_m: (H, W) of the same pixels, NaN hides the road; None: no depth can.
        within: share of the distance by which the depth may differ from it, and metres.
    """
    x_m, y_m, z_m = middles
    tolerance, slack_m = within
    fx, fy, cx, cy = projection
    height, width = drivable.shape
    right, down, ahead = (T[0] * x_m + T[1] * y_m[:, None] + T[2] * z_m + T[3] for T in camera_T_ego[:3])
    with np.errstate(all="ignore"):  # what lies behind the camera does not count
        columns, rows = np.rint(fx * right / ahead + cx), np.rint(fy * down / ahead + cy)
        inside = (ahead > _NEAREST_M) & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    v, u, ahead = rows[inside].astype(np.intp), columns[inside].astype(np.intp), ahead[inside]
    near_v, near_u = (np.clip(at + _BESIDE, 0, size - 1) for at, size in ((v, height), (u, width)))
    seen = drivable[near_v[:, None], near_u].sum(axis=(0, 1)) >= _MOST
    if depth_m is not None:
        with np.errstate(invalid="ignore"):
            seen &= np.abs(depth_m[v, u] - ahead) <= tolerance * ahead + slack_m
    visible = np.zeros(z_m.shape, np.uint8)
    visible[inside] = seen
    return visible
