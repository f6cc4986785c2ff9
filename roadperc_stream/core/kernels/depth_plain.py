"""Metres of a depth camera's millimetres and back, by numpy."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

UNKNOWN_MM: Final = 0
DEPTH_LIMIT_MM: Final = 65535


def metres_of_mm(depth_mm: NDArray[np.uint16], depth_m: NDArray[np.float32]) -> None:
    """Write a thousandth of each, in float32; NaN of 0.

    Args:
        depth_mm: (H, W).
        depth_m: (H, W), written.

    Raises:
        ValueError: other sizes.
    """
    _require_equal(depth_mm, depth_m)
    depth_m[...] = depth_mm
    depth_m *= np.float32(0.001)
    depth_m[depth_mm == UNKNOWN_MM] = np.nan


def mm_of_metres(depth_m: NDArray[np.float32], depth_mm: NDArray[np.uint16]) -> None:
    """Write a thousand times each, rounded half to even: 0 of NaN and what is not positive, else 1 to 65535.

    Args:
        depth_m: (H, W).
        depth_mm: (H, W), written.

    Raises:
        ValueError: other sizes.
    """
    _require_equal(depth_m, depth_mm)
    known = depth_m > 0
    with np.errstate(over="ignore"):  # what is too far for a number is beyond the range
        millimetres = np.clip(np.where(known, depth_m, 0.0) * np.float32(1000.0), UNKNOWN_MM, DEPTH_LIMIT_MM)
    depth_mm[...] = np.rint(millimetres)
    depth_mm[known & (depth_mm == UNKNOWN_MM)] = 1


def _require_equal(depths: NDArray[np.generic], into: NDArray[np.generic]) -> None:
    if depths.shape != into.shape:
        raise ValueError(f"{depths.shape} depths into {into.shape}: expected one size")
