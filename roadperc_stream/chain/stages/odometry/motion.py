"""A motion against a keyframe: estimated by perspective from n points, and how uncertain a step is.

RANSAC (Fischler and Bolles 1981) finds the inliers, Gauss-Newton with Huber's weights refines the motion and says how
far each point pulls it. A point's error is that of its pixel, and that of its depth as far as a change of depth would
shift the pixel: so far points with poor depth still determine the rotation.

Both poses are measured against the same features. What is wrong with a feature's point pulls them alike and leaves the
step between them as it is, so it is the differences of the pulls that count, not their sum. Features that lie together
err together (on one object, one shadow, one patch of stretched road): the pulls' scatter is taken over features and
over cells of the image (the cluster-robust estimate of Liang and Zeger, "Longitudinal data analysis using generalized
linear models", Biometrika 73, 1986).
"""

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from roadperc_stream.chain.kernels import linearise
from roadperc_stream.chain.kernels.odometry_plain import Projection, Weighting
from roadperc_stream.config import scaled
from roadperc_stream.geometry import Camera, Float, Float32, adjoint, inverse, rigid
from roadperc_stream.geometry.rotations import rotation_from_vector
from roadperc_stream.model import Mask

Scale = Literal["measured", "carried", "none"]
PIXEL_STD_PX = 0.5
"""Standard deviation of a tracked point, at 960 rows, by which points are weighed."""
INLIER_PX: Final = 2.0
"""Largest distance, at 960 rows, of an inlier from where the motion predicts it: four standard deviations."""
RANSAC_ITERATIONS: Final = 200
"""Most motions tried: with half of the points wrong, one of sets of five is right with 99.8 %."""
_DEPTH_STD_PER_M: Final = 0.0005
"""The depth's standard deviation over the distance squared, as stereo has it: it weighs the points."""
_HUBER = 1.5
_ITERATIONS = 8
_CONFIDENCE = 0.999
_SMALLEST_SET = 6
_SINGULAR = 1e12
"""Condition number of normal equations that do not determine the motion."""
_CONVERGED = 1e-6
"""Metres and radians below which another iteration changes nothing."""
_CELLS: Final = 8
"""Cells, side by side, within which features err together."""
_SYSTEMATIC: Final = 0.001
"""Share of a step by which all features err alike, which no scatter shows: windows follow a stretch only in part."""
_FREE: Final = 6
"""Numbers of a motion."""


@dataclass(frozen=True)
class Motion:
    """``this_T_key`` maps the keyframe's camera coordinates to this frame's camera.

    ``inliers`` are the (N,) features that agree, ``points_m`` the (N, 3) points of the keyframe's features as far as
    they are known after the motion. ``influence`` are the (N, 6) small translations and rotations (m, rad) of this
    camera in its own axes by which each feature's residual pulls the motion, 0 where it has none; None where they are
    not known. ``scaled`` says that the length is in the unit of known points; ``length_variance`` is the part of its
    variance, in square metres, that the influence does not show. ``scale`` says how the road gave the length, None if
    the points gave it; ``noise_variance`` is then the part of the variance that later motions do not share.
    """

    this_T_key: Float
    inliers: Mask
    points_m: Float
    influence: Float | None
    scaled: bool
    length_variance: float = 0.0
    scale: Scale | None = None
    noise_variance: float = 0.0


def motion_from_points(camera: Camera, points_m: Float, px: Float32, start: Float | None = None) -> Motion | None:
    """The metric motion that projects points to the pixels where they were found; None if too few points agree.

    ``points_m`` are (N, 3) in the keyframe's camera, NaN unknown; ``px`` are (N, 2) in this frame, NaN not found. The
    search begins at ``start``, else at a motion that RANSAC finds.
    """
    usable = np.flatnonzero(np.isfinite(points_m).all(axis=1) & np.isfinite(px).all(axis=1))
    if len(usable) < _SMALLEST_SET:
        return None
    X, observed = points_m[usable], px[usable].astype(float)
    first = _consensus(camera, X, observed) if start is None else start
    if first is None:
        return None
    this_T_key, agreeing, pulls = refined(camera, X, observed, first)
    inliers = np.zeros(len(px), bool)
    inliers[usable[agreeing]] = True
    influence = None
    if pulls is not None:
        influence = np.zeros((len(px), 6))
        influence[inliers] = pulls
    return Motion(this_T_key, inliers, points_m, influence, scaled=True)


def _consensus(camera: Camera, X: Float, px: Float) -> Float | None:
    found, rotation, translation, _ = cv2.solvePnPRansac(
        X,
        px,
        camera.K,
        None,
        iterationsCount=RANSAC_ITERATIONS,
        reprojectionError=scaled(INLIER_PX, camera.height),
        confidence=_CONFIDENCE,
        flags=cv2.SOLVEPNP_ITERATIVE,
    )
    if not found:
        return None
    return rigid(rotation_from_vector(np.ravel(rotation)), np.ravel(translation).astype(float))


def refined(camera: Camera, X: Float, px: Float, this_T_key: Float) -> tuple[Float, Mask, Float | None]:
    """The motion refined by Gauss-Newton, (N,) inliers, and their (M, 6) influence.

    ``X`` are (N, 3) points in the keyframe's camera, ``px`` their (N, 2) pixels in this frame. Every iteration chooses
    the inliers again. The influence is None if the points do not determine the motion.
    """
    std_px = scaled(PIXEL_STD_PX, camera.height)
    projection = Projection(camera.fx, camera.fy, camera.cx, camera.cy)
    weighting = Weighting(std_px, _DEPTH_STD_PER_M, _HUBER, INLIER_PX / PIXEL_STD_PX)
    for _ in range(_ITERATIONS):
        residual, J, agrees = linearise(projection, weighting, X, px, this_T_key)
        N = J.T @ J
        least, *_, most = np.linalg.eigvalsh(N)
        if np.sum(agrees) < _SMALLEST_SET or not least * _SINGULAR > most:
            return this_T_key, agrees.astype(bool), None
        small = np.asarray(np.linalg.solve(N, residual @ J), np.float64)
        this_T_key = moved(small) @ this_T_key
        if np.abs(small).max() < _CONVERGED:
            break
    known = agrees.astype(bool)
    each = (J * residual[:, None]).reshape(-1, 2, 6).sum(axis=1)[known]
    return this_T_key, known, np.linalg.solve(N, each.T).T


def moved(small: Float) -> Float:
    """(4, 4) transform of a small (6,) translation and rotation vector."""
    return rigid(rotation_from_vector(small[3:]), small[:3])


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

    None where no more features pull than a motion has numbers: they fit any motion.
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
