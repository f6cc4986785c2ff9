"""How uncertain a step is, by how far each feature of the keyframe pulls the two poses that it lies between.

Both poses are measured against the same features. What is wrong with a feature's point pulls them alike and leaves the
step between them as it is, so it is the differences of the pulls that count, not their sum. Features that lie together
err together (on one object, one shadow, one patch of stretched road): the pulls' scatter is taken over features and
over cells of the image (the cluster-robust estimate of Liang and Zeger, "Longitudinal data analysis using generalized
linear models", Biometrika 73, 1986).
"""

from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float, Float32, adjoint, inverse

_CELLS: Final = 8
"""Cells, side by side, within which features err together."""
_SYSTEMATIC: Final = 0.001
"""Share of a step by which all features err alike, which no scatter shows: windows follow a stretch only so far."""
_FREE: Final = 6
"""Numbers of a motion."""


def in_ego_axes(ego_T_camera: Float, influence: Float | None) -> Float | None:
    """(N, 6) small motions of the camera as those of the ego frame fixed to it."""
    return None if influence is None else influence @ adjoint(ego_T_camera).T


def step_covariance(
    key_px: Float32, width: int, this: Float | None, last: Float | None, last_T_this: Float, length_variance: float
) -> tuple[float, ...]:
    """Covariance of the step between two poses measured against one keyframe, row by row.

    Args:
        key_px: (N, 2) the keyframe's features.
        width: of its image.
        this: (N, 6) how far each feature pulls this pose, in ego's axes; None where that is not known.
        last: (N, 6) the same of the last pose, in its own axes.
        last_T_this: the step.
        length_variance: square metres, of the step's length, beyond what the features show.

    Returns:
        36 numbers, of a small translation and rotation (m, rad) in this ego frame's axes; none where a pull is not
        known, or too few features pull to tell.
    """
    if this is None or last is None:
        return ()
    this_T_last = inverse(last_T_this)
    covariance = scatter(this - last @ adjoint(this_T_last).T, key_px, width)
    if covariance is None:
        return ()
    along = this_T_last[:3, 3]
    length_m = float(np.linalg.norm(along))
    if length_m > 0:
        variance = (_SYSTEMATIC * length_m) ** 2 + length_variance
        covariance[:3, :3] += variance * np.outer(along, along) / length_m**2
    return tuple(covariance.ravel().tolist())


def scatter(pulls: Float, key_px: Float32, width: int) -> Float | None:
    """(6, 6) covariance of the sum of (N, 6) pulls of features at (N, 2) pixels of an image; zero rows do not count.

    None where no more features pull than a motion has numbers: they fit whatever is true.
    """
    used = np.abs(pulls).sum(axis=1) > 0
    pulls, px = pulls[used], key_px[used]
    if len(pulls) <= _FREE:
        return None
    column, row = (px // (width / _CELLS)).astype(int).T
    _, cell = np.unique(row * _CELLS + column, return_inverse=True)
    together = np.zeros((int(cell.max()) + 1, _FREE))
    np.add.at(together, cell, pulls)
    alone = pulls.T @ pulls * (len(pulls) / (len(pulls) - _FREE))
    return np.asarray(alone + together.T @ together * (len(together) / max(len(together) - 1, 1)))
