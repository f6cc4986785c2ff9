"""The length of a motion without depth, from the road's image and the last known speed.

Between two images a plane maps by the homography R - t n^T / h (Hartley and Zisserman, Multiple View Geometry, 2004,
section 13.1). The tracked points give the rotation R and the direction of t, the mounting gives the height h. The
length of t and the pitch of n remain unknown. Asphalt has too little texture for corners, but the whole road aligns
well. The search maximises the normalised correlation over the length, as Song and Chandraker do over the height
("Robust Scale Estimation in Real-Time Monocular SFM", CVPR 2014). One Gauss-Newton step at the maximum gives the
dependence of length and pitch.
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch, updated
from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.motion import Motion, Scale
from roadperc_stream.config import scaled
from roadperc_stream.geometry import Camera, Float, Float32, inverse, project, rays, rigid, transform
from roadperc_stream.geometry.ground import tilted_ground
from roadperc_stream.geometry.planes import Plane, intersect_plane, transform_plane
from roadperc_stream.model import Image, Mask

_PLANE_STD: Final = np.deg2rad(1.0)
"""Additional standard deviation of the pitch by the road's image: a road is crowned and patched."""
_ROAD_SHARE: Final = 0.01
"""Additional standard deviation of a length by the road, as a share, for the same reason."""
_LENGTH_PER_PITCH: Final = 5.0
"""Default share of a length per radian of pitch."""
_SIGMAS: Final = 3.0
_SEARCHED: Final = 0.3
"""Search range below and above the expected length, as its share."""
_CARRIED_SHARE: Final = 0.2
"""Largest standard deviation, as a share of the length, at which the last speed gives the scale."""
_AHEAD_M: Final = (2.0, 18.0)
_HALF_WIDTH_M: Final = 2.2
"""Extent of the road ahead of the camera and to either side."""
_BLUR_PX: Final = 51.0
"""Side, at 960 rows, of the subtracted local mean: shadows and vignetting do not move with the road."""
_LEAST_PIXELS: Final = 1000
_MOST_PIXELS: Final = 16384
_ROAD_PART: Final = 2.0
"""Ratio of the image below the horizon to its road; larger images are subsampled."""
_LEAST_CORRELATION: Final = 0.5
_GRAIN_PX: Final = 16.0
"""Pixels that err together, from the deviations of lengths and pitches on real logs."""
_TRIED_PX: Final = 0.7
"""Shift of the road's image between two tried lengths."""
_MOST_TRIED: Final = 200
_SMALL_PX: Final = 0.25
_SMALL_PITCH: Final = 0.002
"""Pitch step of the numerical derivative, radians."""


@dataclass(frozen=True)
class Expected:
    """The expected length in metres at the last known speed, with its variance."""

    length_m: float
    variance: float


@dataclass(frozen=True)
class RoadView:
    """The road in the keyframe: (M, 3) rays and (M,) grey levels of its pixels, and how many share one error.

    ``camera`` has both images, ``plane`` is the road in the keyframe's camera.
    """

    camera: Camera
    plane: Plane
    rays: Float
    levels: Float32
    alike: float


@dataclass(frozen=True)
class RoadMotion:
    """A length in metres that fits the road's image at the assumed pitch, with its variance.

    ``pitch`` is the correction of the pitch that the image shows, radians, with its variance; ``metres_per_pitch`` is
    the derivative of the length by the pitch.
    """

    length_m: float
    variance: float
    metres_per_pitch: float
    pitch: float
    pitch_variance: float


def scaled_by_road(
    frame: TrackingFrame,
    key_grey: Image,
    motion: Motion,
    pitch: CameraPitch,
    expected: Expected | None,
    longest_m: float,
) -> tuple[Motion, CameraPitch]:
    """The motion with the length that the road shows, else the expected length; and the updated pitch.

    ``key_grey`` is the keyframe's image. The pitch counts if the road's plane is assumed from the mounting.
    ``expected`` is the length at the last known speed, ``longest_m`` the length at the greatest possible speed.
    """
    length = float(np.linalg.norm(motion.this_T_key[:3, 3]))
    R, t = motion.this_T_key[:3, :3], motion.this_T_key[:3, 3] / length
    tried_m = 0.0, longest_m
    if expected is not None:
        reach_m = _SEARCHED * expected.length_m + _SIGMAS * float(np.sqrt(expected.variance))
        tried_m = max(expected.length_m - reach_m, 0.0), min(expected.length_m + reach_m, longest_m)
    found = _on_road(frame, key_grey, (R, t), pitch, tried_m)
    if found is None:
        return _carried(motion, pitch, expected), pitch
    if _is_assumed(frame):
        sharper = updated(pitch, (pitch.offset + found.pitch, found.pitch_variance + _PLANE_STD**2))
        found = replace(found, length_m=found.length_m + found.metres_per_pitch * (sharper.offset - pitch.offset))
        pitch = sharper
    length_m, noise = _fused(found, expected)
    shared = found.metres_per_pitch**2 * pitch.variance if _is_assumed(frame) else 0.0
    return _with_length(motion, "measured", length_m, noise, shared), pitch


def _on_road(
    frame: TrackingFrame, key_grey: Image, turn: tuple[Float, Float], pitch: CameraPitch, tried_m: tuple[float, float]
) -> RoadMotion | None:
    if frame.road is None:
        return None
    plane = frame.road.plane
    if _is_assumed(frame):
        plane = transform_plane(inverse(frame.ego_T_camera), tilted_ground(frame.ego_T_camera, pitch.offset))
    # The camera moves along the road: it was as high above it at the keyframe.
    key_plane = Plane.of(turn[0].T @ plane.n, plane.offset_m)
    view = road_view(frame.camera, frame.ego_T_camera, key_plane, key_grey)
    if view is None:
        return None
    return road_motion(view, frame.grey, frame.movable, turn, tried_m)


def _is_assumed(frame: TrackingFrame) -> bool:
    return frame.road is not None and frame.road.source == "assumed"


def _fused(found: RoadMotion, expected: Expected | None) -> tuple[float, float]:
    """Length and variance, fused from the road and the expected length.

    If they contradict each other, the expected length counts, but with a standard deviation of a third of their
    difference: a single wrong match changes nothing, and a second one that confirms the first one is believed.
    """
    noise = found.variance + (_ROAD_SHARE * found.length_m) ** 2
    if expected is None:
        return found.length_m, noise
    off = expected.length_m - found.length_m
    if off**2 > _SIGMAS**2 * (noise + expected.variance):
        return expected.length_m, (off / _SIGMAS) ** 2
    gain = noise / (noise + expected.variance)
    return found.length_m + gain * off, (1.0 - gain) * noise


def _carried(motion: Motion, pitch: CameraPitch, expected: Expected | None) -> Motion:
    if expected is None or expected.variance > (_CARRIED_SHARE * expected.length_m) ** 2:
        return replace(motion, scaled=False, scale="none")
    shared = (_LENGTH_PER_PITCH * expected.length_m) ** 2 * pitch.variance
    return _with_length(motion, "carried", expected.length_m, expected.variance, shared)


def _with_length(motion: Motion, scale: Scale, length_m: float, noise: float, shared: float) -> Motion:
    """The motion scaled to a length, with its triangulated points."""
    factor = length_m / float(np.linalg.norm(motion.this_T_key[:3, 3]))
    R, t = motion.this_T_key[:3, :3], motion.this_T_key[:3, 3]
    influence = None if motion.influence is None else motion.influence * ([factor] * 3 + [1.0] * 3)
    return replace(
        motion,
        this_T_key=rigid(R, factor * t),
        points_m=factor * motion.points_m,
        influence=influence,
        scaled=True,
        length_variance=noise + shared,
        scale=scale,
        noise_variance=noise,
    )


def high_pass(grey: Image) -> Float32:
    """(H, W) an image without its slow changes of brightness."""
    levels = grey.astype(np.float32)
    side = round(scaled(_BLUR_PX, grey.shape[0])) | 1
    return np.asarray(levels - cv2.blur(levels, (side, side)), np.float32)


def road_view(camera: Camera, ego_T_camera: Float, plane: Plane, key_grey: Image) -> RoadView | None:
    """The pixels of the keyframe on the road ahead, without regard to obstacles; None if they are too few."""
    horizon = int(np.clip(np.floor(camera.cy - camera.fy * plane.normal[2] / plane.normal[1]), 0, camera.height - 1))
    apart = int(np.ceil(np.sqrt((camera.height - horizon) * camera.width / _MOST_PIXELS / _ROAD_PART)))
    rows, columns = np.mgrid[horizon : camera.height : apart, 0 : camera.width : apart].reshape(2, -1)
    px = np.stack((columns, rows), axis=-1).astype(float)
    ahead = transform(ego_T_camera, intersect_plane(camera, px, plane)) - ego_T_camera[:3, 3]
    with np.errstate(invalid="ignore"):
        near = (ahead[:, 0] > _AHEAD_M[0]) & (ahead[:, 0] < _AHEAD_M[1]) & (np.abs(ahead[:, 1]) < _HALF_WIDTH_M)
    chosen = np.flatnonzero(near)[:_MOST_PIXELS]
    if len(chosen) < _LEAST_PIXELS:
        return None
    levels = high_pass(key_grey)[rows[chosen], columns[chosen]]
    return RoadView(camera, plane, rays(camera, px[chosen]), levels, max(_GRAIN_PX / apart**2, 1.0))


def road_motion(
    view: RoadView,
    grey: Image,
    movable: Image | None,
    key_T_this_turn: tuple[Float, Float],
    tried_m: tuple[float, float],
) -> RoadMotion | None:
    """The length of a motion by the road's image.

    Args:
        view: the road in the keyframe.
        grey: (H, W) this image.
        movable: (H, W) not 0 on movable objects in this image, or None.
        key_T_this_turn: the (3, 3) rotation R and the (3,) unit direction t with X_this = R X_key + length t.
        tried_m: shortest and longest length.

    Returns:
        The length; None if the road has too little texture or no length fits clearly.
    """
    picture = _Picture(view, high_pass(grey), movable, *key_T_this_turn)
    shift_px = picture.shift_px_per_m
    if not 0 < shift_px < np.inf:  # a wrong motion turns the road out of sight
        return None
    step_m = max(_TRIED_PX / shift_px, (tried_m[1] - tried_m[0]) / _MOST_TRIED)
    lengths = np.arange(tried_m[0], tried_m[1] + step_m, step_m)
    fits = np.array([picture.correlation(length) for length in lengths])
    best = int(np.argmax(fits))
    if not 0 < best < len(lengths) - 1 or fits[best] < _LEAST_CORRELATION:
        return None
    before, at, after = fits[best - 1 : best + 2]
    bend = before - 2 * at + after
    peak_m = float(lengths[best] + (step_m * 0.5 * (before - after) / bend if bend < 0 else 0.0))
    return _at_peak(picture, peak_m, _SMALL_PX / shift_px)


@dataclass(frozen=True)
class _Picture:
    """The keyframe's road mapped to this image at a length and a pitch."""

    view: RoadView
    levels: Float32
    movable: Image | None
    R: Float
    t: Float

    @property
    def shift_px_per_m(self) -> float:
        """Root mean square of the shift of the road's pixels with the length."""
        apart = self._px(0.05, 0.0) - self._px(0.0, 0.0)
        return float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) / 0.05

    def correlation(self, length_m: float) -> float:
        """Correlation over the visible pixels, -1 to 1; -1 if they are too few."""
        seen, visible = self.seen(length_m, 0.0)
        if int(np.sum(visible)) < _LEAST_PIXELS:
            return -1.0
        return float(normalised(self.view.levels[visible]) @ normalised(seen[visible]))

    def seen(self, length_m: float, pitch: float) -> tuple[Float32, Mask]:
        """(M,) levels of this image at the road's pixels, and (M,) which of them are visible."""
        columns, rows = (np.ascontiguousarray(px, np.float32) for px in self._px(length_m, pitch).T)
        height, width = self.levels.shape
        visible: Mask = (columns >= 0) & (columns <= width - 1) & (rows >= 0) & (rows <= height - 1)
        if self.movable is not None:
            at = tuple(np.rint(px[visible]).astype(int) for px in (rows, columns))
            visible[visible] = self.movable[at] == 0
        seen = cv2.remap(self.levels, columns[:, None], rows[:, None], cv2.INTER_LINEAR)
        return np.asarray(seen, np.float32)[:, 0], visible

    def _px(self, length_m: float, pitch: float) -> Float:
        """(M, 2) pixels in this image, by the plane's homography; ``pitch`` turns the plane about the camera."""
        nx, ny, nz = self.view.plane.normal
        turned = np.array([nx, ny - pitch * nz, nz + pitch * ny])
        homography = self.R - np.outer(length_m * self.t, turned) / self.view.plane.offset_m
        return project(self.view.camera, self.view.rays @ homography.T)


def _at_peak(picture: _Picture, length_m: float, small_m: float) -> RoadMotion | None:
    """The motion at the best length for the assumed pitch, with the correction of the pitch."""
    at = picture.seen(length_m, 0.0)
    moved = [picture.seen(length_m + s * small_m, 0.0) for s in (-1, 1)]
    tilted = [picture.seen(length_m, s * _SMALL_PITCH) for s in (-1, 1)]
    visible = np.all([mask for _, mask in (at, *moved, *tilted)], axis=0)
    if int(np.sum(visible)) < _LEAST_PIXELS:
        return None
    residual = normalised(picture.view.levels[visible]) - normalised(at[0][visible])
    J = np.stack(
        [
            (normalised(after[visible]) - normalised(before[visible])) / (2 * small)
            for ((before, _), (after, _)), small in ((moved, small_m), (tilted, _SMALL_PITCH))
        ],
        axis=-1,
    )
    N = J.T @ J
    per_pixel = float(residual @ residual) / len(residual) * picture.view.alike
    determinant = float(np.linalg.det(N))
    if N[0, 0] <= 0 or determinant <= 1e-9 * N[0, 0] * N[1, 1]:
        return None
    pitch = float(np.linalg.solve(N, J.T @ residual)[1])
    pitch_variance = per_pixel * float(N[0, 0]) / determinant
    return RoadMotion(length_m, per_pixel / float(N[0, 0]), -float(N[0, 1] / N[0, 0]), pitch, pitch_variance)


def normalised(levels: Float32) -> Float:
    """(M,) with zero mean and unit length; zeros where all are equal."""
    centred = levels.astype(float) - float(levels.mean())
    return centred / max(float(np.linalg.norm(centred)), 1e-9)
