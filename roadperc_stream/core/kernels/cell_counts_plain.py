"""How many points of the road and of obstacles lie in the cells of a grid, by numpy."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.ray_points_plain import Rays, points_along_rays

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]
Counts = NDArray[np.int64]


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
    known, None: over the plane; ``drivable`` (H, W) 0 or 1; ``tags`` (H, W) of their classes.
    """

    depth_m: Float32
    height_m: Float32 | None
    drivable: Marks
    tags: Marks


def count_points(
    cells: Cells, pixels: KnownPixels, rays: Rays, abd: Float32, obstacle_tags: Marks, free: Counts, occupied: Counts
) -> None:
    """Add to each cell its drivable points of known height, and its points that stand in the way.

    In the way are points that are high enough, or of an obstacle, and not so high that one passes below. A point may
    be both.

    Args:
        cells: the grid.
        pixels: of which points are made.
        rays: of the pixels.
        abd: (3,) the road as a x + b y + z = d.
        obstacle_tags: (256,) 1 of tags of an obstacle, else 0.
        free: (rows along y, columns along x), changed.
        occupied: likewise.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    depth_m, height_m, drivable, tags = pixels
    require_belonging(
        depth_m.shape,
        *(part.shape for part in rays),
        abd.shape,
        None if height_m is None else height_m.shape,
        *(a.shape for a in (drivable, tags, obstacle_tags, free, occupied)),
    )
    points = np.empty((3, *depth_m.shape), np.float32)
    points_along_rays(depth_m, *rays, points)
    x, y, z = points
    with np.errstate(invalid="ignore", over="ignore"):
        height = z - (abd[2] - abd[0] * x - abd[1] * y) if height_m is None else height_m
        high = height >= np.float32(cells.min_height)
        in_the_way = (high | obstacle_tags[tags].view(bool)) & (height <= np.float32(cells.max_height))
    on_road = drivable.view(bool) & np.isfinite(height)
    free += _counts(cells, x[on_road], y[on_road], free.shape)
    occupied += _counts(cells, x[in_the_way], y[in_the_way], free.shape)


def require_belonging(*shapes: tuple[int, ...] | None) -> None:
    """Check the shapes of the arrays that ``count_points`` takes, in its order.

    Raises:
        ValueError: sizes that do not belong together.
    """
    depth, column, row, start, abd, height, drivable, tags, obstacle_tags, free, occupied = shapes
    marks, sizes = {drivable, tags, height or depth}, (column, row, start, abd, obstacle_tags)
    if depth is None or marks != {depth} or sizes != ((3, depth[1]), (3, depth[0]), (3,), (3,), (256,)):
        raise ValueError(f"rays, marks, tags or heights of other sizes than {depth} depths")
    if free != occupied:
        raise ValueError(f"counts of {free} and {occupied}")


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
