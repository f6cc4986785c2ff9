"""How many points of the road and of obstacles lie in the cells of a grid, by numpy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def count_points(
    cells: Cells,
    x: Float32,
    y: Float32,
    height: Float32,
    drivable: Marks,
    obstacles: Marks,
    free: Counts,
    occupied: Counts,
) -> None:
    """Add to each cell its drivable points of known height, and its points that stand in the way.

    In the way are points that are high enough, or of an obstacle, and not so high that one passes below. A point may
    be both.

    Args:
        cells: the grid.
        x: (H, W) metres; NaN lies in no cell.
        y: (H, W).
        height: (H, W) over the road; NaN where it is not known.
        drivable: (H, W) 0 or 1.
        obstacles: (H, W) 0 or 1.
        free: (rows along y, columns along x), changed.
        occupied: likewise.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    if len({x.shape, y.shape, height.shape, drivable.shape, obstacles.shape}) > 1 or free.shape != occupied.shape:
        raise ValueError(f"{x.shape} points of other sizes, or counts of {free.shape} and {occupied.shape}")
    with np.errstate(invalid="ignore"):
        high = height >= np.float32(cells.min_height)
        in_the_way = (high | obstacles.view(bool)) & (height <= np.float32(cells.max_height))
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
