"""What ``object_points_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]
Numbers = tuple[float, float, float, float]


def object_points(
    depth_m: NDArray[np.float32],
    camera: Numbers,
    box: tuple[int, int, int, int, int],
    of_class: tuple[Image, Image] | None,
    distance_m: float,
    behind_m: tuple[float, float],
    ego_T_camera: Float,
    circle: Numbers,
) -> tuple[Float, Float, Float]:
    """The points of a box's pixels that lie so far behind a distance, and where they are beside a circle.

    That is exact on the circle, and without a singularity where it is a straight line.

    Args:
        depth_m: (H, W) NaN unknown.
        camera: fx, fy, cx and cy in pixels.
        box: first column and row and those behind the last, in the image, and the step from one pixel that is looked
            at to the next of a row or column.
        of_class: (H, W) tags, and (256,) above 0 at those that the points may have; None for all.
        distance_m: of the object.
        behind_m: by how much more their own are at least and at most, both exclusive.
        ego_T_camera: (4, 4).
        circle: how far it is to the left at x = 0 of the ego frame, cosine and sine of its heading there, and its
            curvature.

    Returns:
        (N, 3) points in the camera's frame, (N,) their distances, row by row, and (N,) how far they are to the left of
        the circle, square to it.

    Raises:
        ValueError: other sizes.
    """
    (height, width), (x0, y0, x1, y1, step) = depth_m.shape, box
    fits = x0 >= 0 and x1 <= width and y0 >= 0 and y1 <= height and step > 0 and ego_T_camera.shape == (4, 4)
    if not fits or (of_class and (of_class[0].shape, of_class[1].shape) != ((height, width), (256,))):
        raise ValueError(
            f"{height}x{width} depths, every {step}. of {box[:4]}, do not fit their tags, 256 of them or (4, 4)"
        )
    fx, fy, cx, cy = camera
    part = slice(y0, max(y1, y0), step), slice(x0, max(x1, x0), step)
    x, y = (np.arange(x0, x1, step) - cx) / fx, (np.arange(y0, y1, step) - cy) / fy
    depths = depth_m[part].astype(np.float64)
    behind = depths * np.sqrt(x**2 + (y**2 + 1.0)[:, None]) - distance_m
    chosen = (behind > behind_m[0]) & (behind < behind_m[1])
    if of_class:
        chosen &= of_class[1][of_class[0][part]] > 0
    rows, columns = np.nonzero(chosen)
    z = depths[chosen]
    points = np.stack((x[columns] * z, y[rows] * z, z), axis=-1)
    return points, np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + z**2), _lateral(points, ego_T_camera, circle)


def _lateral(points: Float, ego_T_camera: Float, circle: Numbers) -> Float:
    """(N,) how far (N, 3) points are to the left of a circle, summed in the order of the coordinates."""
    offset_m, cosine, sine, bend = circle
    along, across = (
        row[0] * points[:, 0] + row[1] * points[:, 1] + row[2] * points[:, 2] + row[3] for row in ego_T_camera[:2]
    )
    across = across - offset_m
    ahead, aside = cosine * along + sine * across, cosine * across - sine * along
    to_centre = np.hypot(bend * ahead, 1.0 - bend * aside)
    lateral: Float = (2.0 * aside - bend * (ahead**2 + aside**2)) / (1.0 + to_centre)
    return lateral


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
