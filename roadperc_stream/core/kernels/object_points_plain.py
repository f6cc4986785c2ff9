"""What ``object_points_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]


def object_points(
    depth_m: NDArray[np.float32],
    x: Float,
    y: Float,
    of_class: tuple[Image, Image] | None,
    distance_m: float,
    behind_m: tuple[float, float],
) -> tuple[Float, Float]:
    """The points of pixels that lie so far behind a distance.

    Args:
        depth_m: (h, w) NaN unknown.
        x: (w,) the rays of the columns, z = 1.
        y: (h,) and those of the rows.
        of_class: (h, w) tags, and (256,) above 0 at those that the points may have; None for all.
        distance_m: of the object.
        behind_m: by how much more their own are at least and at most, both exclusive.

    Returns:
        (N, 3) points in the camera's frame and (N,) their distances, row by row.

    Raises:
        ValueError: other sizes.
    """
    size = len(y), len(x)
    if depth_m.shape != size or (of_class and (of_class[0].shape, of_class[1].shape) != (size, (256,))):
        raise ValueError(f"{depth_m.shape} depths do not fit {size} rays, their tags and 256 of them")
    depths = depth_m.astype(np.float64)
    behind = depths * np.sqrt(x**2 + (y**2 + 1.0)[:, None]) - distance_m
    chosen = (behind > behind_m[0]) & (behind < behind_m[1])
    if of_class:
        chosen &= of_class[1][of_class[0]] > 0
    rows, columns = np.nonzero(chosen)
    z = depths[chosen]
    points = np.stack((x[columns] * z, y[rows] * z, z), axis=-1)
    return points, np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + z**2)


def mean_direction(points: Float, ranges_m: Float, most_m: float) -> tuple[float, float]:
    """Mean x and y at z = 1 of the (N, 3) points that are no farther, of (N,) distances; NaN of none.

    Summed from the first to the last.

    Raises:
        ValueError: other sizes.
    """
    if points.shape != (len(ranges_m), 3):
        raise ValueError(f"{points.shape} points of {len(ranges_m)} distances")
    nearest = points[ranges_m <= most_m]
    if not len(nearest):
        return np.nan, np.nan
    x, y = ((np.cumsum(nearest[:, :2] / nearest[:, 2:], axis=0)[-1] + 0.0) / len(nearest)).tolist()  # no sum is -0
    return x, y
