"""Cells of a grid on the road that an image shows to be drivable, by numpy."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.reprojection_plain import Projection

Float = NDArray[np.float64]

_MOST: Final = 5
"""Of a pixel and its eight neighbours."""
_BESIDE: Final = np.arange(-1, 2)[:, None]
_NEAREST_M: Final = 1e-6


class Middles(NamedTuple):
    """Of a grid's cells, ego frame: ``x_m`` (C,) of columns, ``y_m`` (R,) of rows, the road's ``z_m`` (R, C)."""

    x_m: Float
    y_m: Float
    z_m: Float


def mark_visible(
    projection: Projection,
    camera_T_ego: Float,
    middles: Middles,
    drivable: NDArray[np.uint8],
    depth_m: NDArray[np.float32] | None,
    tolerance: float,
    slack_m: float,
    visible: NDArray[np.uint8],
) -> None:
    """Mark the cells whose middle is visible as drivable, at its own distance where the depth is dense.

    A pixel counts as drivable where most of it and its eight neighbours are: a single one among others shows nothing,
    a single hole among drivable ones hides nothing. Beyond the image lies what is at its edge.

    Args:
        projection: of the camera.
        camera_T_ego: (4, 4).
        middles: of the cells.
        drivable: (H, W) 0 or 1.
        depth_m: (H, W) of the same pixels, NaN hides the road; None: no depth can.
        tolerance: share of the distance by which the depth may differ from it.
        slack_m: and metres.
        visible: (R, C), written: 0 or 1.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    x_m, y_m, z_m = middles
    require_belonging(
        *(a.shape for a in (camera_T_ego, x_m, y_m, z_m, drivable)),
        None if depth_m is None else depth_m.shape,
        visible.shape,
    )
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
    visible[:] = 0
    visible[inside] = seen


def require_belonging(*shapes: tuple[int, ...] | None) -> None:
    """Check the shapes of the arrays that ``mark_visible`` takes, in its order.

    Raises:
        ValueError: sizes that do not belong together.
    """
    transform, x, y, z, drivable, depth, visible = shapes
    if transform != (4, 4) or not z == visible == (*(y or ()), *(x or ())) or (depth or drivable) != drivable:
        raise ValueError(
            f"{z} cells and {visible} marks of {y} rows and {x} columns, {drivable} pixels, {depth} depths"
        )
