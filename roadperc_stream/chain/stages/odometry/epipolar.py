"""A motion without depth: rotation and direction from the essential matrix, the length from known points.

Five-point RANSAC in OpenCV's USAC form (Nister 2004; Raguram et al. 2013), then least squares over Sampson's distance
with Huber's loss. The length comes from known points: on the road's plane below the camera, or triangulated by earlier
motions. If a rotation explains the shift of the image, the camera stands still. An essential matrix would then fit
noise.
"""

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry.motion import INLIER_PX, PIXEL_STD_PX, RANSAC_ITERATIONS, Motion
from roadperc_stream.config import scaled
from roadperc_stream.geometry import Camera, Float, Float32, project, rays, rigid
from roadperc_stream.geometry.rotations import rotation_from_vector
from roadperc_stream.model import Mask

_SMALLEST_SET = 8
_CONFIDENCE = 0.999
_MIN_KNOWN = 5
"""Minimum number of known points for a length."""
_MIN_DEPTH_PARALLAX_PX = 5.0
"""Parallax, at 960 rows, from which a point is triangulated."""
_EVALUATIONS = 20
MIN_PARALLAX_PX = 1.5
"""Shift of the points at 960 rows, beyond that of the rotation, below which the camera stands still: three standard
deviations."""
_STANDING_SHARE = 0.75
"""Minimum share of the points that a rotation alone predicts if the camera stands still."""
_FOUND_SHARE = 0.25
"""Minimum share of the features that are found if the camera stands still; after a long step only far ones are."""
_AS_EXPECTED = 0.99
"""Cosine of the angle to the expected direction from which the best sample needs no comparison."""
_ALIKE = 0.9
"""Cosine of the angle between two directions from which they are alike."""
_STILL_M = 1e-3
"""Length of a motion below which its direction is rounding error."""
_REWEIGHTINGS = 5
_SMALL_ANGLE = 1e-4
"""Radians; smaller residuals do not increase the weight."""


def motion_from_rays(
    camera: Camera,
    key_px: Float32,
    px: Float32,
    points_m: Float,
    fallback_length: float,
    expected_this_T_key: Float | None = None,
) -> Motion | None:
    """The motion since the keyframe, and the points that it triangulates; None if too few points agree.

    The search starts from random samples and from ``expected_this_T_key``, (4, 4); the motion with which more points
    agree counts. If few points are near, the best sample may have a wrong direction.

    The features are at the (N, 2) pixels ``key_px`` and ``px`` (NaN: not found). ``points_m`` are their (N, 3) points
    in the keyframe's camera, NaN unknown. With too few known points the motion has the ``fallback_length``.
    """
    usable = np.flatnonzero(np.isfinite(px).all(axis=1))
    if len(usable) < _SMALLEST_SET:
        return None
    a, b = rays(camera, key_px[usable].astype(float)), rays(camera, px[usable].astype(float))
    if (turn := standing_still(camera, key_px, px)) is not None:
        shift_px = np.linalg.norm(project(camera, rays(camera, key_px.astype(float)) @ turn.T) - px, axis=1)
        inliers = shift_px < scaled(INLIER_PX, camera.height)
        return Motion(rigid(turn, np.zeros(3)), inliers, points_m, None, scaled=True)
    direction = _direction(camera, a, b, expected_this_T_key)
    if direction is None:
        return None
    R, t, agrees, pulls = direction
    inliers = np.zeros(len(px), bool)
    inliers[usable[agrees]] = True
    known = agrees & np.isfinite(points_m[usable, 2])
    length = _length(camera, R, t, points_m[usable][known], b[known])
    metres, variance = length or (fallback_length, 0.0)
    filled = points_m.copy()
    new = usable[agrees & ~np.isfinite(points_m[usable, 2])]
    filled[new] = _triangulated(camera, R, metres * t, *(rays(camera, p[new].astype(float)) for p in (key_px, px)))
    influence = np.zeros((len(px), 6))
    influence[usable] = pulls * ([metres] * 3 + [1.0] * 3)
    return Motion(rigid(R, metres * t), inliers, filled, influence, length is not None, variance)


def standing_still(camera: Camera, before_px: Float32, px: Float32) -> Float | None:
    """(3, 3) rotation of a camera that stands still between two images; None if it has moved.

    The features are at (N, 2) pixels in both images, NaN not found. The rotation alone predicts nearly all of them.
    """
    found = np.isfinite(px).all(axis=1)
    if not np.sum(found) > _FOUND_SHARE * len(px):
        return None
    a = rays(camera, before_px[found].astype(float))
    R = _turn(a, rays(camera, px[found].astype(float)))
    shift_px = np.linalg.norm(project(camera, a @ R.T) - px[found], axis=1)
    return R if np.quantile(shift_px, _STANDING_SHARE) < scaled(MIN_PARALLAX_PX, camera.height) else None


def parallax_px(camera: Camera, key_px: Float32, px: Float32, motion: Motion) -> float:
    """Median shift of the (N, 2) features that agree on a motion, beyond that of its rotation."""
    agrees = motion.inliers & np.isfinite(px[:, 0])
    turned = project(camera, rays(camera, key_px[agrees].astype(float)) @ motion.this_T_key[:3, :3].T)
    return float(np.median(np.linalg.norm(turned - px[agrees], axis=1))) if agrees.any() else 0.0


def _turn(a: Float, b: Float) -> Float:
    """(3, 3) rotation with b ~ R a, by the orthogonal Procrustes solution (Kabsch 1976) reweighted to an L1 fit."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    weights = np.ones(len(a))
    for _ in range(_REWEIGHTINGS):
        U, _, Vt = np.linalg.svd((b * weights[:, None]).T @ a)
        R: Float = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        weights = 1.0 / np.maximum(np.linalg.norm(b - a @ R.T, axis=1), _SMALL_ANGLE)
    return R


def _direction(
    camera: Camera, a: Float, b: Float, expected_this_T_key: Float | None
) -> tuple[Float, Float, Mask, Float] | None:
    """R and unit t with b ~ R a + t, (N,) inliers, and the (N, 6) pulls of all points on t and R."""
    gate = scaled(INLIER_PX, camera.height) / camera.fx
    start = _by_sampling(a, b, gate)
    sampled = None if start is None else _from_start(camera, *start, a, b, gate)
    expected_m = np.zeros(3) if expected_this_T_key is None else expected_this_T_key[:3, 3]
    length_m = np.linalg.norm(expected_m)
    if length_m < _STILL_M or (sampled is not None and sampled[1] @ expected_m > _AS_EXPECTED * length_m):
        return sampled
    continued = _from_start(camera, _turn(a, b), expected_m / length_m, a, b, gate)
    if sampled is None or continued is None:
        return sampled or continued
    opposite = continued[1] @ sampled[1] < -_ALIKE  # the sample's points are in front of the camera
    return sampled if opposite or np.sum(continued[2]) <= np.sum(sampled[2]) else continued


def _by_sampling(a: Float, b: Float, gate: float) -> tuple[Float, Float] | None:
    """R and unit t of the best random sample; None without a unique one."""
    E, _ = cv2.findEssentialMat(
        a[:, :2],
        b[:, :2],
        np.eye(3),
        method=cv2.USAC_DEFAULT,
        prob=_CONFIDENCE,
        threshold=gate,
        maxIters=RANSAC_ITERATIONS,
    )
    if E is None or E.shape != (3, 3):
        return None
    _, rotation, translation, _ = cv2.recoverPose(E, a[:, :2], b[:, :2], np.eye(3), mask=None)
    return np.asarray(rotation, float), np.ravel(np.asarray(translation, float))


def _from_start(
    camera: Camera, R: Float, t: Float, a: Float, b: Float, gate: float
) -> tuple[Float, Float, Mask, Float] | None:
    """As ``_direction``, by least squares from a start; None if too few points agree with it."""
    agrees = np.abs(_sampson(R, t, a, b)) < gate
    if int(np.sum(agrees)) < _SMALLEST_SET:
        return None
    pulls = np.zeros((len(a), 6))
    R, t, pulls[agrees] = _refined(camera, R, t, a[agrees], b[agrees])
    return R, t, np.abs(_sampson(R, t, a, b)) < gate, pulls


def _refined(camera: Camera, R: Float, t: Float, a: Float, b: Float) -> tuple[Float, Float, Float]:
    """Least squares over the rotation and the direction's two tangents, and each point's pull on both.

    A pull is a small motion, as ``Motion.influence``; its rotation also turns t.
    """
    from scipy.optimize import least_squares

    tangents = np.linalg.svd(t[None])[2][1:]

    def at(small: Float) -> tuple[Float, Float]:
        moved = t + small[3:] @ tangents
        return np.asarray(rotation_from_vector(small[:3]) @ R), moved / np.linalg.norm(moved)

    std = scaled(PIXEL_STD_PX, camera.height) / camera.fx
    fit = least_squares(
        lambda small: _sampson(*at(small), a, b) / std, np.zeros(5), loss="huber", max_nfev=_EVALUATIONS
    )
    # The Jacobian contains the square roots of Huber's weights; the residuals do not.
    weighted = fit.fun * np.sqrt(np.minimum(1.0, 1.0 / np.maximum(np.abs(fit.fun), 1.0)))
    pulls = -(fit.jac * weighted[:, None]) @ np.linalg.pinv(fit.jac.T @ fit.jac)
    R, t = at(fit.x)
    return R, t, np.hstack((pulls[:, 3:] @ tangents - np.cross(pulls[:, :3], t), pulls[:, :3]))


def _sampson(R: Float, t: Float, a: Float, b: Float) -> Float:
    """(N,) signed distance to the epipolar geometry, in units of the rays' plane z = 1."""
    E = np.cross(t, R, axisb=0, axisc=0)
    Ea, Eb = a @ E.T, b @ E
    return np.asarray(np.sum(b * Ea, axis=1) / np.sqrt(np.sum(Ea[:, :2] ** 2 + Eb[:, :2] ** 2, axis=1)))


def _length(camera: Camera, R: Float, t: Float, X: Float, b: Float) -> tuple[float, float] | None:
    """Length of the motion and its variance, from known points.

    Each point gives a length: b x (R X + length t) = 0. Their weighted median starts a least squares over the points
    that agree with it. None if these are too few.
    """
    if len(X) < _MIN_KNOWN:
        return None
    turned = X @ R.T
    across, along = np.cross(b, turned), np.cross(b, t)
    lengths = -np.sum(across * along, axis=1) / np.sum(along**2, axis=1)
    px_per_m = camera.fx * np.linalg.norm(along, axis=1) / np.abs(turned[:, 2])
    order = np.argsort(lengths)
    cumulative = np.cumsum(px_per_m[order])
    median = float(lengths[order][np.searchsorted(cumulative, cumulative[-1] / 2)])
    close = np.abs(lengths - median) * px_per_m < scaled(INLIER_PX, camera.height)
    if not median > 0 or int(np.sum(close)) < _MIN_KNOWN:
        return None
    weights = px_per_m[close] ** 2
    return float(weights @ lengths[close] / weights.sum()), scaled(PIXEL_STD_PX, camera.height) ** 2 / weights.sum()


def _triangulated(camera: Camera, R: Float, t: Float, a: Float, b: Float) -> Float:
    """(N, 3) points in the first camera that the motion has shifted far enough in the image, NaN for the others."""
    across, shift = np.cross(b, a @ R.T), np.cross(b, t)
    strength = np.sum(across**2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -np.sum(across * shift, axis=1) / strength
        enough = camera.fx * np.sqrt(strength) > scaled(_MIN_DEPTH_PARALLAX_PX, camera.height)
        return np.asarray(a * np.where(enough & (depth > 0), depth, np.nan)[:, None])
