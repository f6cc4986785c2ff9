"""The motion since a keyframe by perspective-n-point (PnP), and the covariance of a step.

RANSAC (Fischler and Bolles 1981) finds the inliers. Gauss-Newton with Huber's weights refines the motion and gives the
influence of each point on it. A point's error combines that of its pixel and the pixel shift that its depth error
causes. Thus distant points with poor depth still determine the rotation. Huber's weights: Robust estimation of a
location parameter, Annals of Mathematical Statistics 35, 1964.

Both poses are measured against the same features. An error of a feature's point pulls both poses alike and cancels in
the step, so the covariance uses the differences of the pulls. Neighbouring features err together, for example on one
object or one shadow. The scatter of the pulls is therefore summed over features and over image cells: the
cluster-robust estimate of Liang and Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73,
1986.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import scaled
from roadperc_stream.geometry import Camera, Float, Float32, adjoint, inverse, rays, rigid
from roadperc_stream.geometry.rotations import rotation_from_vector
from roadperc_stream.model import Mask

Scale = Literal["measured", "points", "carried", "none"]
PIXEL_STD_PX = 0.5
"""Standard deviation of a tracked point at 960 rows; it sets the weights of the points."""
INLIER_PX: Final = 2.0
"""Largest distance of an inlier from its predicted pixel at 960 rows: four standard deviations."""
RANSAC_ITERATIONS: Final = 200
"""Limit of tried motions: with half of the points wrong, a correct set of five is among them with 99.8 %."""
_DEPTH_STD_PER_M: Final = 0.0005
"""Standard deviation of the depth over the squared distance, as for stereo; it sets the weights of the points."""
_HUBER = 1.5
_ITERATIONS = 8
_CONFIDENCE = 0.999
_SMALLEST_SET = 6
_SINGULAR = 1e12
"""Condition number of normal equations that do not determine the motion."""
_CONVERGED = 1e-6
"""Metres and radians below which another iteration changes nothing."""
_CELLS: Final = 8
"""Cells across the image; features within one cell err together."""
_SYSTEMATIC: Final = 0.001
"""Error shared by all features, as a share of the step; the scatter does not show it. Windows follow a stretch only in
part."""
_FAR_M: Final = 60.0
"""Distance of points whose depth is unknown, for a camera that stands still."""
_NEAREST_M: Final = 0.1
"""Points nearer to the camera, or behind it, do not count."""
_FREE: Final = 6
"""Degrees of freedom of a motion."""


@dataclass(frozen=True)
class Motion:
    """``this_T_key`` maps the keyframe's camera coordinates to this frame's camera.

    ``inliers`` are the (N,) features that agree. ``points_m`` are the (N, 3) points of the keyframe's features, NaN
    where unknown after the motion. ``influence`` (N, 6) is the small translation and rotation (m, rad) of this camera,
    in its own axes, that each feature's residual causes; 0 for unused features, None if unknown. ``scaled``: the length
    is in the unit of known points. ``length_variance`` is the part of its variance, in square metres, that the
    influence does not show. ``scale`` is the source of a length by the road; None if the points give the length. With
    a ``scale``, ``noise_variance`` is the part of ``length_variance`` that later motions do not share. ``doubts`` are
    the last ratios of lengths by the road to lengths by points, which they contradict. ``still`` is the (6, 6)
    covariance of a camera that stands still, in its axes.
    """

    this_T_key: Float
    inliers: Mask
    points_m: Float
    influence: Float | None
    scaled: bool
    length_variance: float = 0.0
    scale: Scale | None = None
    noise_variance: float = 0.0
    doubts: tuple[float, ...] = ()
    still: Float | None = None


def motion_from_points(camera: Camera, points_m: Float, px: Float32, start: Float | None = None) -> Motion | None:
    """The metric motion that projects points to their found pixels; None if too few points agree.

    ``points_m`` are (N, 3) in the keyframe's camera, NaN unknown; ``px`` are (N, 2) in this frame, NaN not found. The
    search begins at ``start`` if given, else at the motion by RANSAC.
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
    for _ in range(_ITERATIONS):
        residual, J, agrees = linearise(camera, X, px, this_T_key)
        N = J.T @ J
        least, *_, most = np.linalg.eigvalsh(N)
        if np.sum(agrees) < _SMALLEST_SET or not least * _SINGULAR > most:
            return this_T_key, agrees, None
        small = np.asarray(np.linalg.solve(N, residual @ J), np.float64)
        this_T_key = moved(small) @ this_T_key
        if np.abs(small).max() < _CONVERGED:
            break
    each = (J * residual[:, None]).reshape(-1, 2, 6).sum(axis=1)[agrees]
    return this_T_key, agrees, np.linalg.solve(N, each.T).T


def standing_motion(camera: Camera, points_m: Float, key_px: Float32, px: Float32, motion: Motion) -> Motion:
    """The motion of a camera that stands still, with its covariance: noise, and a hidden motion straight ahead.

    The (N, 3) points of the (N, 2) features are far where they are unknown (NaN), so their parallax shows less.
    """
    used = motion.inliers
    far = rays(camera, key_px[used].astype(float)) * _FAR_M
    X = np.where(np.isfinite(points_m[used, 2:]), points_m[used], far)
    residual, J, _ = linearise(camera, X, px[used].astype(float), motion.this_T_key)
    J = J[:, 2:]
    covariance = np.zeros((6, 6))
    covariance[2:, 2:] = np.linalg.pinv(J.T @ J)
    hidden = covariance[2:, 2:] @ (residual @ J)
    covariance[2, 2] += hidden[0] ** 2
    variance = float(covariance[2, 2])
    return replace(motion, still=covariance, noise_variance=variance, length_variance=variance)


def linearise(camera: Camera, points_m: Float, px: Float, this_T_key: Float) -> tuple[Float, Float, Mask]:
    """Weighted residuals of a (4, 4) motion and their derivatives, in standard deviations.

    ``points_m`` are (N, 3) in the keyframe's camera, found at (N, 2) ``px`` in this frame. Rows are multiplied by the
    square root of Huber's weight, so the products of the rows are the weighted normal equations.

    Returns:
        (2 N,) residuals, u and v of each point; (2 N, 6) derivatives by a small translation and rotation of this
        camera's coordinates; (N,) points in front of the camera and within the gate. All are 0 for other points.
    """
    fx, fy = camera.fx, camera.fy
    std_px = scaled(PIXEL_STD_PX, camera.height)
    X, Y, Z = points_m.T
    along_x, along_y, along_z, moved_m = this_T_key[:3].T[:, :, None]
    with np.errstate(all="ignore"):  # points behind the camera are set to 0 below
        x, y, z = along_x * X + along_y * Y + along_z * Z + moved_m
        ray_x, ray_y, ray_z = along_x * (X / Z) + along_y * (Y / Z) + along_z
        a, b, c, d = fx / z, -fx * x / (z * z), fy / z, -fy * y / (z * z)
        off_px = np.stack((px[:, 0] - (fx * x / z + camera.cx), px[:, 1] - (fy * y / z + camera.cy)))
        along_u, along_v = a * ray_x + b * ray_z, c * ray_y + d * ray_z
        depth_std_m = _DEPTH_STD_PER_M * (Z * Z)
        variance = std_px**2 + (along_u * along_u + along_v * along_v) * (depth_std_m * depth_std_m)
        off = np.sqrt((off_px[0] * off_px[0] + off_px[1] * off_px[1]) / variance)
        agrees: Mask = (z > _NEAREST_M) & (off < INLIER_PX / PIXEL_STD_PX)
        weight = np.sqrt(np.where(off > _HUBER, _HUBER / off, 1.0) / variance)
        zero = np.zeros_like(z)
        derivative_px = np.stack(
            ((a, zero, b, b * y, a * z - b * x, -a * y), (zero, c, d, d * y - c * z, -d * x, c * x))
        ).transpose(2, 0, 1)
        residual, derivative = (weight * off_px).T, weight[:, None, None] * derivative_px
    residual, derivative = np.where(agrees[:, None], residual, 0.0), np.where(agrees[:, None, None], derivative, 0.0)
    return residual.reshape(-1), derivative.reshape(-1, 6), agrees


def moved(small: Float) -> Float:
    """(4, 4) transform of a small (6,) translation and rotation vector."""
    return rigid(rotation_from_vector(small[3:]), small[:3])


def in_ego_axes(ego_T_camera: Float, influence: Float | None) -> Float | None:
    """(N, 6) small motions of the ego frame from those of the camera fixed to it."""
    return None if influence is None else influence @ adjoint(ego_T_camera).T


def step_covariance(
    key_px: Float32, width: int, this: Float | None, last: Float | None, last_T_this: Float, length_variance: float
) -> tuple[float, ...]:
    """Covariance of the step between two poses measured against one keyframe, row by row.

    Args:
        key_px: (N, 2) the keyframe's features.
        width: width of its image.
        this: (N, 6) pull of each feature on this pose, in the ego frame's axes; None if unknown.
        last: (N, 6) the same for the last pose, in its own axes.
        last_T_this: the step.
        length_variance: additional variance of the step's length, square metres.

    Returns:
        36 numbers for a small translation and rotation (m, rad) in this ego frame's axes; empty if a pull is unknown
        or too few features pull.
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


def cells(px: Float32, width: int) -> NDArray[np.intp]:
    """(N,) cell of the image of (N, 2) pixels; features within one cell err together."""
    column, row = (px // (width / _CELLS)).astype(int).T
    return np.asarray(row * _CELLS + column, np.intp)


def scatter(pulls: Float, key_px: Float32, width: int) -> Float | None:
    """(6, 6) covariance of the sum of (N, 6) pulls of features at (N, 2) pixels of an image; zero rows are left out.

    None if the features are no more than the degrees of freedom, because they fit any motion.
    """
    used = np.abs(pulls).sum(axis=1) > 0
    pulls, px = pulls[used], key_px[used]
    if len(pulls) <= _FREE:
        return None
    _, cell = np.unique(cells(px, width), return_inverse=True)
    together = np.zeros((int(cell.max()) + 1, _FREE))
    np.add.at(together, cell, pulls)
    alone = pulls.T @ pulls * (len(pulls) / (len(pulls) - _FREE))
    return np.asarray(alone + together.T @ together * (len(together) / max(len(together) - 1, 1)))
