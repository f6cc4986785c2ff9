"""Points of depth pixels in a turned and moved frame, by numpy."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


class Rays(NamedTuple):
    """The rays of an image's pixels, whose coordinates are parts of the column and the row.

    ``column`` is (3, W), ``row`` (3, H); ``start_m`` (3,) is where they begin.
    """

    column: Float32
    row: Float32
    start_m: Float32


def points_along_rays(depth_m: Float32, column: Float32, row: Float32, start_m: Float32, points: Float32) -> None:
    """Write the points at these depths along the rays of an image's pixels.

    Args:
        depth_m: (H, W); of NaN the point is NaN.
        column: (3, W) a pixel's column's part of its ray's coordinates.
        row: (3, H) its row's.
        start_m: (3,) where the rays begin.
        points: (3, H, W) coordinates, written.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    height, width = depth_m.shape
    if (column.shape, row.shape, start_m.shape, points.shape) != ((3, width), (3, height), (3,), (3, height, width)):
        raise ValueError(f"rays of {row.shape} and {column.shape}, {points.shape} points of {height}x{width} depths")
    with np.errstate(invalid="ignore", over="ignore"):
        np.add(row[:, :, None], column[:, None, :], out=points)
        points *= depth_m
        points += start_m[:, None, None]
