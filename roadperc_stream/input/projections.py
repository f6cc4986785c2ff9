"""Checks intrinsic matrices, and decomposes the projection matrices of a stereo pair."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, baseline_of, decompose_projection

_ROUNDING_PX: Final = 1e-9
"""Largest rounding error of a decomposition in a skew of zero."""


def require_pinhole(where: str, K: Float) -> None:
    """Check that a (3, 3) matrix is that of a camera without skew.

    Raises:
        DumpError: it is not; the message starts with ``where``.
    """
    upper = K[0, 1] == K[1, 0] == 0 and K[2].tolist() == [0, 0, 1]
    if not (upper and K[0, 0] > 0 and K[1, 1] > 0):
        raise DumpError(f"{where}: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {K.tolist()}")


@dataclass(frozen=True)
class ProjectionPair:
    """A rectified stereo pair, from two projection matrices."""

    K_left: Float
    K_right: Float
    baseline_m: float
    along_rows: bool
    """True if the right camera lies along the first axis of the left one."""


def decompose_pair(path: Path, P_left: Float, P_right: Float) -> ProjectionPair:
    """Return K of both (3, 4) matrices, and the distance of their centres -M^-1 p4 with P = [M | p4] and M = K R.

    Raises:
        DumpError: a matrix is not a projection, or both have the same centre.
    """
    K_left, R_left, centre_left = _decompose(f"{path}: P_left", P_left)
    K_right, _, centre_right = _decompose(f"{path}: P_right", P_right)
    try:
        baseline_m = baseline_of(P_left, P_right)
    except ValueError as error:
        raise DumpError(f"{path}: P_left and P_right: {error}") from error
    offset = R_left @ (centre_right - centre_left)
    return ProjectionPair(K_left, K_right, baseline_m, bool(offset[0] > 0.99 * baseline_m))


def _decompose(where: str, P: Float) -> tuple[Float, Float, Float]:
    try:
        K, R, centre = decompose_projection(P)
    except ValueError as error:
        raise DumpError(f"{where}: {error}") from error
    K[np.abs(K) < _ROUNDING_PX] = 0.0
    require_pinhole(where, K)
    return K, R, centre
