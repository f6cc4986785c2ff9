"""A motion against a keyframe, and its estimation where the points are known: perspective from n points.

RANSAC (Fischler and Bolles 1981) finds who agrees, Gauss-Newton with Huber's weights refines the motion and says how
far each point pulls it. A point's error is that of its pixel, and that of its depth as far as a change of depth would
shift the pixel: so far points with poor depth still determine the rotation.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.core.config import OdometryConfig, scaled
from roadperc_stream.core.datatypes import Mask
from roadperc_stream.core.geometry import Camera, Float, Float32, project, rigid, transform

PIXEL_STD_PX = 0.5
"""Standard deviation of a tracked point, at 960 rows, by which points are weighed."""
_HUBER = 1.5
_ITERATIONS = 8
_CONFIDENCE = 0.999
_SMALLEST_SET = 6
_SINGULAR = 1e12
"""Condition number of normal equations that do not determine the motion."""
_NEAREST_M = 0.1
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
    return rigid(Rotation.from_rotvec(np.ravel(rotation)).as_matrix(), np.ravel(translation).astype(float))


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
    gate = cfg.inlier_px / PIXEL_STD_PX
    pulls = None
    for _ in range(_ITERATIONS):
        residual, J, off = _linearised(cfg, camera, X, px, this_T_key, std_px)
        agrees = off < gate
        residual, J, off = residual[agrees].ravel(), J[agrees].reshape(-1, 6), off[agrees]
        weights = np.minimum(1.0, _HUBER / np.maximum(off, _HUBER))
        weighted = J.T * np.repeat(weights, 2)
        N = weighted @ J
        if len(off) < _SMALLEST_SET or np.linalg.cond(N) > _SINGULAR:
            return this_T_key, agrees, None
        small = np.linalg.solve(N, weighted @ residual)
        this_T_key = moved(small) @ this_T_key
        pulls = np.linalg.solve(N, (weighted * residual).reshape(6, -1, 2).sum(axis=2)).T
        if np.abs(small).max() < _CONVERGED:
            break
    return this_T_key, agrees, pulls


def _linearised(
    cfg: OdometryConfig, camera: Camera, X: Float, px: Float, this_T_key: Float, std_px: float
) -> tuple[Float, Float, Float]:
    """(N, 2) residuals and (N, 2, 6) derivatives in standard deviations, and the (N,) residuals' lengths.

    A point not in front of the camera is infinitely far off.
    """
    points = transform(this_T_key, X)
    ahead = points[:, 2] > _NEAREST_M
    points[~ahead] = (0.0, 0.0, 1.0)
    P = _projection_derivative(camera, points)
    residual = px - project(camera, points)
    along = np.einsum("nij,nj->ni", P, (X / X[:, 2:]) @ this_T_key[:3, :3].T)
    depth_std_m = cfg.depth_std_per_m * X[:, 2] ** 2
    std = np.sqrt(std_px**2 + np.sum(along**2, axis=1) * depth_std_m**2)
    J = np.concatenate((P, -P @ _cross_matrices(points)), axis=2) / std[:, None, None]
    residual /= std[:, None]
    return residual, J, np.where(ahead, np.linalg.norm(residual, axis=1), np.inf)


def _projection_derivative(camera: Camera, X: Float) -> Float:
    """(N, 2, 3) derivative of the pixel with respect to the point."""
    x, y, z = X.T
    zero = np.zeros_like(z)
    return np.stack(
        (
            np.stack((camera.fx / z, zero, -camera.fx * x / z**2), axis=-1),
            np.stack((zero, camera.fy / z, -camera.fy * y / z**2), axis=-1),
        ),
        axis=1,
    )


def _cross_matrices(X: Float) -> Float:
    """(N, 3, 3) matrices with M v = X x v."""
    x, y, z = X.T
    zero = np.zeros_like(x)
    return np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=-1).reshape(-1, 3, 3)


def moved(small: Float) -> Float:
    """(4, 4) transform of a small (6,) translation and rotation vector."""
    return rigid(Rotation.from_rotvec(small[3:]).as_matrix(), small[:3])
