"""Errors of an estimated path against the true one: absolute, relative, and as KITTI counts them.

Poses are (N, 4, 4) transforms from the ego frame to a world, lengths in metres, angles in degrees.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.core.geometry import Float

from ..options import DeltaUnit

Indices = NDArray[np.intp]
_PATH_TOLERANCE: Final = 0.1
"""Share of a path length by which that of a pair may differ."""


@dataclass(frozen=True)
class Delta:
    """How far apart the poses of a pair are: a number of poses, or metres along the estimated path."""

    size: float
    unit: DeltaUnit


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of errors that are never negative, in the errors' unit; ``std`` is the population's."""

    count: int
    rmse: float
    mean: float
    median: float
    std: float
    least: float
    most: float
    sse: float

    @classmethod
    def of(cls, errors: Float) -> "ErrorStatistics":
        """Of (N,) errors, at least one."""
        sse = float(np.sum(errors**2))
        return cls(
            count=len(errors),
            rmse=float(np.sqrt(sse / len(errors))),
            mean=float(errors.mean()),
            median=float(np.median(errors)),
            std=float(errors.std()),
            least=float(errors.min()),
            most=float(errors.max()),
            sse=sse,
        )


def absolute_errors_m(estimated: Float, true: Float) -> Float:
    """(N,) distances between places: the absolute trajectory error.

    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, 2012, section V.B.
    """
    distances: Float = np.linalg.norm(estimated[:, :3, 3] - true[:, :3, 3], axis=1)
    return distances


def pairs(estimated: Float, delta: Delta) -> tuple[Indices, Indices]:
    """(M,) first and second poses of all pairs that lie ``delta`` apart; they overlap.

    Over metres each pose is paired with the later one whose path from there comes nearest to the length, the earliest
    of equals; where that is off by more than a tenth, the pose begins no pair.
    """
    if delta.unit == "frames":
        first = np.arange(max(len(estimated) - int(delta.size), 0))
        return first, first + int(delta.size)
    return _pairs_along(path_m(estimated), delta.size)


def _pairs_along(driven_m: Float, length_m: float) -> tuple[Indices, Indices]:
    first = np.arange(len(driven_m) - 1)
    after = np.minimum(np.searchsorted(driven_m, driven_m[:-1] + length_m), len(driven_m) - 1)
    before = np.maximum(after - 1, first + 1)
    before_off, after_off = (np.abs(driven_m[k] - driven_m[:-1] - length_m) for k in (before, after))
    earliest = np.maximum(np.searchsorted(driven_m, driven_m[before]), first + 1)
    second = np.where(before_off <= after_off, earliest, after)
    near = np.minimum(before_off, after_off) <= _PATH_TOLERANCE * length_m
    return first[near], second[near]


def relative_errors(estimated: Float, true: Float, first: Indices, second: Indices) -> tuple[Float, Float]:
    """(M,) metres and (M,) degrees by which the motion of each pair differs from the true one.

    Source: Sturm et al. 2012, section V.A: the transform that is left when the true motion is undone.
    """
    left = motions(motions(true[first], true[second]), motions(estimated[first], estimated[second]))
    return np.linalg.norm(left[:, :3, 3], axis=1), angles_deg(left[:, :3, :3])


def segment_errors(estimated: Float, true: Float, length_m: float, every: int) -> tuple[Float, Float]:
    """(M,) percent and (M,) degrees per 100 m, over stretches of the true path that begin at each ``every``-th pose.

    A stretch ends at the first pose that lies farther along the true path than ``length_m``, and its errors are divided
    by ``length_m``, as the benchmark's own program does.
    Source: Geiger, Lenz and Urtasun, Are we ready for autonomous driving? The KITTI vision benchmark suite, 2012.
    """
    driven_m = path_m(true)
    first = np.arange(0, len(true), every)
    second = np.searchsorted(driven_m, driven_m[first] + length_m, side="right")
    whole = second < len(true)
    off_m, off_deg = relative_errors(estimated, true, first[whole], second[whole])
    return 100 * off_m / length_m, 100 * off_deg / length_m


def path_m(poses: Float) -> Float:
    """(N,) metres along the path up to each pose."""
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps_m)))


def motions(world_T_a: Float, world_T_b: Float) -> Float:
    """(N, 4, 4) a_T_b of two stacks of rigid transforms."""
    R = np.swapaxes(world_T_a[:, :3, :3], 1, 2)
    a_T_b = world_T_b.copy()
    a_T_b[:, :3, :3] = R @ world_T_b[:, :3, :3]
    a_T_b[:, :3, 3] = np.einsum("nij,nj->ni", R, world_T_b[:, :3, 3] - world_T_a[:, :3, 3])
    return a_T_b


def angles_deg(rotations: Float) -> Float:
    """(N,) angles of (N, 3, 3) rotations, degrees; accurate for small angles."""
    angles: Float = np.degrees(Rotation.from_matrix(rotations).magnitude())
    return angles
