"""Laying an estimated path over the true one before they are compared."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float, inverse
from roadperc_stream.errors import TableError

from ..options import Alignment

_STANDING: Final = 1e-12
"""Share of the paths' squared size below which a common extent is rounding."""


@dataclass(frozen=True)
class Similarity:
    """Maps a point p to scale R p + translation_m: (3, 3) rotation R, (3,) translation in metres."""

    rotation: Float
    translation_m: Float
    scale: float = 1.0

    def points(self, points_m: Float) -> Float:
        """(N, 3) points, mapped."""
        result: Float = self.scale * points_m @ self.rotation.T + self.translation_m
        return result

    def poses(self, poses: Float) -> Float:
        """(N, 4, 4) poses: their places mapped, their axes turned, never scaled."""
        mapped = poses.copy()
        mapped[:, :3, 3] = self.points(poses[:, :3, 3])
        mapped[:, :3, :3] = self.rotation @ poses[:, :3, :3]
        return mapped


def umeyama(source_m: Float, target_m: Float, *, with_scale: bool) -> Similarity:
    """The similarity that takes (N, 3) points to (N, 3) others with the least sum of squared distances.

    Points on one line leave the turn about it free, and points in one place every turn: the distances are the least all
    the same. Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991,
    equations 34 to 43.

    Raises:
        ValueError: a scale is asked for, and points without any extent in common cannot tell it.
    """
    source_mean, target_mean = source_m.mean(axis=0), target_m.mean(axis=0)
    source, target = source_m - source_mean, target_m - target_mean
    U, singular, Vt = np.linalg.svd(target.T @ source)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U * signs @ Vt
    scale = _scale(float(signs @ singular), source, target) if with_scale else 1.0
    return Similarity(R, target_mean - scale * R @ source_mean, scale)


def _scale(common_m2: float, source: Float, target: Float) -> float:
    """Umeyama's equation 42 over centred points."""
    if common_m2 <= _STANDING * float(np.sum(source**2) + np.sum(target**2)):
        raise ValueError("one of the paths stands still")
    return common_m2 / float(np.sum(source**2))


def align(estimated: Float, true: Float, how: Alignment) -> Similarity:
    """What lays (N, 4, 4) estimated poses over the true ones.

    ``se3`` turns and shifts, ``sim3`` scales too, both by all places at once; ``origin`` takes the first pose to the
    first true one; ``none`` leaves all as it is.

    Raises:
        TableError: ``sim3``, and one of the paths stands still.
    """
    try:
        return _ALIGNMENTS[how](estimated, true)
    except ValueError as error:
        raise TableError(f"no Sim(3) alignment: {error}, so there is no scale between them") from error


def _first_to_first(estimated: Float, true: Float) -> Similarity:
    true_T_estimated = true[0] @ inverse(estimated[0])
    return Similarity(true_T_estimated[:3, :3], true_T_estimated[:3, 3])


_ALIGNMENTS: Final[Mapping[Alignment, Callable[[Float, Float], Similarity]]] = {
    "se3": lambda estimated, true: umeyama(estimated[:, :3, 3], true[:, :3, 3], with_scale=False),
    "sim3": lambda estimated, true: umeyama(estimated[:, :3, 3], true[:, :3, 3], with_scale=True),
    "origin": _first_to_first,
    "none": lambda _estimated, _true: Similarity(np.eye(3), np.zeros(3)),
}
