"""Alignment of an estimated trajectory to the true one, and its absolute, relative and KITTI errors.

Poses are (N, 4, 4) transforms from the ego frame to a fixed frame, lengths in metres, angles in degrees.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import TableError
from roadperc_stream.geometry import Float, inverse

from ..options import Alignment, DeltaUnit

_STANDING: Final = 1e-12
"""Ratio to the paths' squared size below which their common extent counts as a rounding error."""
Indices = NDArray[np.intp]
_PATH_TOLERANCE: Final = 0.1
"""Ratio by which the path length of a pair may differ from ``Delta``."""


@dataclass(frozen=True)
class Similarity:
    """Maps a point p to scale R p + translation_m: (3, 3) rotation R, (3,) translation in metres."""

    rotation: Float
    translation_m: Float
    scale: float = 1.0

    def poses(self, poses: Float) -> Float:
        """Transform (N, 4, 4) poses; their axes are rotated and not scaled."""
        mapped = poses.copy()
        mapped[:, :3, 3] = self.scale * poses[:, :3, 3] @ self.rotation.T + self.translation_m
        mapped[:, :3, :3] = self.rotation @ poses[:, :3, :3]
        return mapped


def umeyama(source_m: Float, target_m: Float, *, with_scale: bool) -> Similarity:
    """The similarity from (N, 3) points to (N, 3) other points with the smallest sum of squared distances.

    The rotation is not unique for points on a line or in one place, but the distances are minimal.
    Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991,
    equations 34 to 43.

    Raises:
        TableError: the scale is undetermined, because a path stands still.
    """
    source_mean, target_mean = source_m.mean(axis=0), target_m.mean(axis=0)
    source, target = source_m - source_mean, target_m - target_mean
    U, singular, Vt = np.linalg.svd(target.T @ source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U * signs @ Vt
    scale = 1.0
    if with_scale:  # equation 42
        common_m2 = float(signs @ singular)
        if common_m2 <= _STANDING * float(np.sum(source**2) + np.sum(target**2)):
            raise TableError("no Sim(3) alignment, because the scale is unknown: one of the paths stands still")
        scale = common_m2 / float(np.sum(source**2))
    return Similarity(R, target_mean - scale * R @ source_mean, scale)


def align(estimated: Float, true: Float, alignment: Alignment) -> Similarity:
    """The similarity that aligns (N, 4, 4) estimated poses to the true ones.

    ``se3`` rotates and translates, ``sim3`` also scales; both use all positions. ``origin`` maps the first pose to the
    first true pose. ``none`` is the identity.

    Raises:
        TableError: with ``sim3``, a path stands still.
    """
    if alignment == "none":
        return Similarity(np.eye(3), np.zeros(3))
    if alignment == "origin":
        true_T_estimated = true[0] @ inverse(estimated[0])
        return Similarity(true_T_estimated[:3, :3], true_T_estimated[:3, 3])
    return umeyama(estimated[:, :3, 3], true[:, :3, 3], with_scale=alignment == "sim3")


@dataclass(frozen=True)
class Delta:
    """Distance between the poses of a pair: a number of poses, or metres along the estimated path."""

    size: float
    unit: DeltaUnit


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of absolute errors, in their unit; ``std`` is the population's."""

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
        """The statistics of (N,) errors, at least one."""
        sse = np.sum(errors**2)
        spread = errors.mean(), np.median(errors), errors.std(), errors.min(), errors.max()
        return cls(len(errors), *map(float, (np.sqrt(sse / len(errors)), *spread, sse)))


def absolute_errors_m(estimated: Float, true: Float) -> Float:
    """(N,) distances between positions, m: the absolute trajectory error.

    Source: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, 2012, section V.B.
    """
    distances: Float = np.linalg.norm(estimated[:, :3, 3] - true[:, :3, 3], axis=1)
    return distances


def pairs(estimated: Float, delta: Delta) -> tuple[Indices, Indices]:
    """(M,) indices of the first and second poses of all pairs that are ``delta`` apart; pairs overlap.

    In metres, each pose is paired with the later pose whose path length is nearest to ``delta``; among equally
    near ones, with the earliest. A pose has no pair if that length differs by more than a tenth.
    """
    if delta.unit == "frames":
        first = np.arange(max(len(estimated) - int(delta.size), 0))
        return first, first + int(delta.size)
    driven_m, length_m = path_m(estimated), delta.size
    first = np.arange(len(driven_m) - 1)
    after = np.minimum(np.searchsorted(driven_m, driven_m[:-1] + length_m), len(driven_m) - 1)
    before = np.maximum(after - 1, first + 1)
    before_off, after_off = (np.abs(driven_m[k] - driven_m[:-1] - length_m) for k in (before, after))
    earliest = np.maximum(np.searchsorted(driven_m, driven_m[before]), first + 1)
    second = np.where(before_off <= after_off, earliest, after)
    near = np.minimum(before_off, after_off) <= _PATH_TOLERANCE * length_m
    return first[near], second[near]


def relative_errors(estimated: Float, true: Float, first: Indices, second: Indices) -> tuple[Float, Float]:
    """(M,) metres and (M,) degrees by which the motion of each pair differs from the true motion.

    Source: Sturm et al. 2012, section V.A.
    """
    error = motions(motions(true[first], true[second]), motions(estimated[first], estimated[second]))
    return np.linalg.norm(error[:, :3, 3], axis=1), angles_deg(error[:, :3, :3])


def segment_errors(estimated: Float, true: Float, length_m: float, every: int) -> tuple[Float, Float]:
    """(M,) percent and (M,) degrees per 100 m, over stretches of the true path from every ``every``-th pose.

    A stretch ends at the first pose farther along the true path than ``length_m``. Errors are divided by ``length_m``,
    as in the benchmark's program.
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
    """(N,) angles of (N, 3, 3) rotations, degrees; accurate for small angles and half turns."""
    doubled_sines = np.linalg.norm(rotations[:, (2, 0, 1), (1, 2, 0)] - rotations[:, (1, 2, 0), (2, 0, 1)], axis=1)
    angles: Float = np.degrees(np.arctan2(doubled_sines, np.trace(rotations, axis1=1, axis2=2) - 1))
    return angles
