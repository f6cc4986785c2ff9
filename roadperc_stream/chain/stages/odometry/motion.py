"""A motion against a keyframe, and its estimation where the points are known: perspective from n points.

RANSAC (Fischler and Bolles 1981) finds who agrees, Gauss-Newton with Huber's weights refines the motion and says how
far each point pulls it. A point's error is that of its pixel, and that of its depth as far as a change of depth would
shift the pixel: so far points with poor depth still determine the rotation.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from roadperc_stream.core.config import OdometryConfig, scaled
from roadperc_stream.core.datatypes import Mask
from roadperc_stream.core.geometry import Camera, Float, Float32, rigid
from roadperc_stream.core.kernels.reprojection import linearise
from roadperc_stream.core.kernels.reprojection_plain import Projection, Weighting
from roadperc_stream.core.rotations import rotation_from_vector

PIXEL_STD_PX = 0.5
"""Standard deviation of a tracked point, at 960 rows, by which points are weighed."""
_HUBER = 1.5
_ITERATIONS = 8
_CONFIDENCE = 0.999
_SMALLEST_SET = 6
_SINGULAR = 1e12
"""Condition number of normal equations that do not determine the motion."""
_CONVERGED = 1e-6
"""Metres and radians below which another iteration changes nothing."""


@dataclass(frozen=True)
class Motion:
    """``this_T_key`` maps the keyframe's camera coordinates to this frame's camera.

    ``inliers`` are the (N,) features that agree, ``points_m`` the (N, 3) points of the keyframe's features as far as
    they are known after the motion. ``influence`` are the (N, 6) small translations and rotations (m, rad) of this
    camera in its own axes by which each feature's residual pulls the motion, 0 where it has none; None where they are
    not known. ``scaled`` says that the length comes from known points; ``length_variance`` is what of its uncertainty,
    in square metres, the influence does not show.
    """

    this_T_key: Float
    inliers: Mask
    points_m: Float
    influence: Float | None
    scaled: bool
    length_variance: float = 0.0


def motion_from_points(
    cfg: OdometryConfig, camera: Camera, points_m: Float, px: Float32, start: Float | None = None
) -> Motion | None:
    """The motion that projects points to the pixels where they were found.

    Args:
        cfg: thresholds.
        camera: of both frames.
        points_m: (N, 3) in the keyframe's camera, NaN unknown.
        px: (N, 2) pixels in this frame, NaN not found.
        start: a motion nearby; None: RANSAC looks for one.

    Returns:
        The metric motion, or None where too few points agree on any.
    """
    usable = np.flatnonzero(np.isfinite(points_m).all(axis=1) & np.isfinite(px).all(axis=1))
    if len(usable) < _SMALLEST_SET:
        return None
    X, observed = points_m[usable], px[usable].astype(float)
    first = _consensus(cfg, camera, X, observed) if start is None else start
    if first is None:
        return None
    this_T_key, agreeing, pulls = refined(cfg, camera, X, observed, first)
    inliers = np.zeros(len(px), bool)
    inliers[usable[agreeing]] = True
    influence = None
    if pulls is not None:
        influence = np.zeros((len(px), 6))
        influence[inliers] = pulls
    return Motion(this_T_key, inliers, points_m, influence, scaled=True)


def _consensus(cfg: OdometryConfig, camera: Camera, X: Float, px: Float) -> Float | None:
    found, rotation, translation, _ = cv2.solvePnPRansac(
        X,
        px,
        camera.K,
        None,
        iterationsCount=cfg.ransac_iterations,
        reprojectionError=scaled(cfg.inlier_px, camera.height),
        confidence=_CONFIDENCE,
        flags=cv2.SOLVEPNP_ITERATIVE,
    )
    if not found:
        return None
    return rigid(rotation_from_vector(np.ravel(rotation)), np.ravel(translation).astype(float))


def refined(
    cfg: OdometryConfig, camera: Camera, X: Float, px: Float, this_T_key: Float
) -> tuple[Float, Mask, Float | None]:
    """Gauss-Newton over those that agree, who are chosen anew each time.

    Args:
        cfg: thresholds, and the depth's standard deviation.
        camera: of both frames.
        X: (N, 3) points in the keyframe's camera.
        px: (N, 2) pixels in this frame.
        this_T_key: the start.

    Returns:
        this_T_key, (N,) inliers, and the (M, 6) influence of these, None where the points do not determine it.
    """
    std_px = scaled(PIXEL_STD_PX, camera.height)
    projection = Projection(camera.fx, camera.fy, camera.cx, camera.cy)
    weighting = Weighting(std_px, cfg.depth_std_per_m, _HUBER, cfg.inlier_px / PIXEL_STD_PX)
    residual, J, agrees = np.empty(2 * len(X)), np.empty((2 * len(X), 6)), np.empty(len(X), np.uint8)
    for _ in range(_ITERATIONS):
        linearise(projection, weighting, X, px, this_T_key, residual, J, agrees)
        N = J.T @ J
        if np.sum(agrees) < _SMALLEST_SET or _is_singular(N):
            return this_T_key, agrees.astype(bool), None
        small = np.asarray(np.linalg.solve(N, residual @ J), np.float64)
        this_T_key = moved(small) @ this_T_key
        if np.abs(small).max() < _CONVERGED:
            break
    known = agrees.astype(bool)
    each = (J * residual[:, None]).reshape(-1, 2, 6).sum(axis=1)[known]
    return this_T_key, known, np.linalg.solve(N, each.T).T


def _is_singular(N: Float) -> bool:
    """Whether normal equations do not determine the motion."""
    values = np.linalg.eigvalsh(N)
    return not values[0] * _SINGULAR > values[-1]


def moved(small: Float) -> Float:
    """(4, 4) transform of a small (6,) translation and rotation vector."""
    return rigid(rotation_from_vector(small[3:]), small[:3])
