"""The length of a motion from the images of a plane road.

Between two images a plane maps by the homography R - t n^T / h (Hartley and Zisserman, Multiple View Geometry, 2004,
section 13.1). The tracked points give the rotation R and the direction of t, the mounting gives the height h. The
length of t and the pitch of n remain unknown. Asphalt has too little texture for corners, but the whole road aligns
well. The search maximises the normalised correlation over the length, as Song and Chandraker do over the height
("Robust Scale Estimation in Real-Time Monocular SFM", CVPR 2014). One Gauss-Newton step at the maximum gives the
dependence of length and pitch.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.odometry.brightness import high_pass
from roadperc_stream.chain.stages.odometry.epipolar import MIN_PARALLAX_PX
from roadperc_stream.config import scaled
from roadperc_stream.geometry import Camera, Float, Float32, project, rays, transform
from roadperc_stream.geometry.planes import Plane, intersect_plane
from roadperc_stream.model import Image, Mask

_AHEAD_M: Final = (2.0, 18.0)
_HALF_WIDTH_M: Final = 2.2
"""Extent of the road ahead of the camera and to either side."""
_FARTHEST_TURN: Final = 0.8
"""Turn of the car's path, radians, up to which the road is used: beyond it the view ahead shows the roadside."""
_BLOCK_ENDS_M: Final = (4.0, 6.5, 10.0)
_BLOCKS_ACROSS: Final = 3
"""The road is divided at these distances, and across."""
_CLIPPED: Final = 8.0
"""Multiple of the median of the grey levels' sizes at which they are clipped: the shadow of a car ahead moves with that
car. A smaller one hides the dashes of a smooth road, which give the length."""
_STRIP_M: Final = 0.1
"""Width of the strips along the path. The mean of each piece is removed, because a line along the path fits every
length."""
_LEAST_AGREEING: Final = 0.5
"""Minimum share of the road's texture in blocks that correlate."""
_BLUR_PX: Final = 51.0
"""Side, at 960 rows, of the subtracted local mean: shadows and vignetting do not move with the road."""
_LEAST_PIXELS: Final = 1000
_MOST_PIXELS: Final = 16384
_ROAD_PART: Final = 2.0
"""Ratio of the image below the horizon to its road; larger images are subsampled."""
_LEAST_CORRELATION: Final = 0.5
"""Least correlation of both images of the road, and of a part of it that agrees."""
_LEAST_UNEXPECTED: Final = 0.7
"""Least correlation where the length is not expected: among all lengths, a wrong one fits by chance."""
_GRAIN_PX: Final = 16.0
"""Pixels that err together, from the deviations of lengths and pitches on real logs."""
_TRIED_PX: Final = 0.7
"""Shift of the road's image between two tried lengths."""
_MOST_TRIED: Final = 200
_NEARER: Final = 0.5
"""Least shift of the road's image as a share of the features' median one; in real and rendered drives it is 0.9."""
_OTHER_LENGTH_SHARE: Final = 0.2
"""Least difference of another length from the best one, as a share of the best one."""
_AS_GOOD_SHARE: Final = 0.94
"""Correlation of another length, as a share of the best one, from which it cannot be excluded."""
_SEEN_PX: Final = 0.65
"""Least parallax for a length that is not expected: with less, the motion's direction is the tracks' noise."""
_SMALL_PX: Final = 0.25
_SMALL_PITCH: Final = 0.002
"""Pitch step of the numerical derivative, radians."""


@dataclass(frozen=True)
class RoadView:
    """The road in the keyframe: (M, 3) rays and (M,) grey levels of its pixels, and how many share one error.

    ``camera`` has both images, ``plane`` is the road in the keyframe's camera. ``block`` and ``piece`` (M,) number the
    parts of the road, and the pieces of its strips along the car's path, cut at ``_BLOCK_ENDS_M``. Grey levels are
    clipped to ``limit``.
    """

    camera: Camera
    plane: Plane
    rays: Float
    levels: Float32
    alike: float
    block: NDArray[np.intp]
    piece: NDArray[np.intp]
    limit: float


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


def road_view(
    camera: Camera,
    ego_T_camera: Float,
    plane: Plane,
    key_grey: Image,
    key_movable: Image | None = None,
    bend_per_m: float = 0.0,
) -> RoadView | None:
    """The pixels of the keyframe on the road ahead; None if they are too few.

    ``key_movable`` is not 0 on the keyframe's movable objects: a car ahead moves as if the own car stood still. The
    road has the curvature of the car's path, 1/m, positive to the left.
    """
    horizon = int(np.clip(np.floor(camera.cy - camera.fy * plane.normal[2] / plane.normal[1]), 0, camera.height - 1))
    apart = int(np.ceil(np.sqrt((camera.height - horizon) * camera.width / _MOST_PIXELS / _ROAD_PART)))
    rows, columns = np.mgrid[horizon : camera.height : apart, 0 : camera.width : apart].reshape(2, -1)
    px = np.stack((columns, rows), axis=-1).astype(float)
    ahead = transform(ego_T_camera, intersect_plane(camera, px, plane)) - ego_T_camera[:3, 3]
    farthest_m = min(_AHEAD_M[1], _FARTHEST_TURN / max(abs(bend_per_m), 1e-9))
    with np.errstate(invalid="ignore"):
        aside_m = ahead[:, 1] - 0.5 * bend_per_m * ahead[:, 0] ** 2
        near = (ahead[:, 0] > _AHEAD_M[0]) & (ahead[:, 0] < farthest_m) & (np.abs(aside_m) < _HALF_WIDTH_M)
    if key_movable is not None:
        near &= key_movable[rows, columns] == 0
    chosen = np.flatnonzero(near)[:_MOST_PIXELS]
    if len(chosen) < _LEAST_PIXELS:
        return None
    along = np.searchsorted(_BLOCK_ENDS_M, ahead[chosen, 0])
    piece = ((aside_m[chosen] + _HALF_WIDTH_M) / _STRIP_M).astype(int) * (len(_BLOCK_ENDS_M) + 1) + along
    levels = _high_pass(key_grey)[rows[chosen], columns[chosen]]
    limit = _CLIPPED * float(np.median(np.abs(levels)))
    levels = np.clip(levels, -limit, limit)
    across = np.floor((aside_m[chosen] / _HALF_WIDTH_M + 1) / 2 * _BLOCKS_ACROSS).astype(int)
    block = along * _BLOCKS_ACROSS + np.clip(across, 0, _BLOCKS_ACROSS - 1)
    return RoadView(
        camera, plane, rays(camera, px[chosen]), levels, max(_GRAIN_PX / apart**2, 1.0), block, piece, limit
    )


def road_motion(
    view: RoadView,
    grey: Image,
    movable: Image | None,
    key_T_this_turn: tuple[Float, Float],
    tried_m: tuple[float, float],
    *,
    is_expected: bool,
    parallax_px: float,
) -> RoadMotion | None:
    """The length of a motion by the road's image.

    Args:
        view: the road in the keyframe.
        grey: (H, W) this image.
        movable: (H, W) not 0 on movable objects in this image, or None.
        key_T_this_turn: the (3, 3) rotation R and the (3,) unit direction t with X_this = R X_key + length t.
        tried_m: shortest and longest length.
        is_expected: whether the tried lengths are near a well-known one. Otherwise the features must move, the
            correlation must be larger, and no other length may fit as well.
        parallax_px: median shift of the features beyond that of the rotation; the near road moves farther.

    Returns:
        The length; None if the road has too little texture or no length fits clearly.
    """
    picture = _Picture(view, np.clip(_high_pass(grey), -view.limit, view.limit), movable, *key_T_this_turn)
    shift_px = picture.shift_px_per_m
    if not 0 < shift_px < np.inf:  # a wrong motion turns the road out of sight
        return None
    step_m = max(_TRIED_PX / shift_px, (tried_m[1] - tried_m[0]) / _MOST_TRIED)
    least_px = max(scaled(MIN_PARALLAX_PX, grey.shape[0]), _NEARER * parallax_px)
    shortest_m = max(tried_m[0], least_px / shift_px)
    if shortest_m > tried_m[1]:
        return None
    lengths = step_m * np.arange(np.floor(shortest_m / step_m), tried_m[1] / step_m + 1.0)
    fits = np.array([picture.correlation(length) for length in lengths])
    best, least = int(np.argmax(fits)), _LEAST_CORRELATION if is_expected else _LEAST_UNEXPECTED
    if not 0 < best < len(lengths) - 1 or fits[best] < least:
        return None
    others = fits[np.abs(lengths - lengths[best]) > _OTHER_LENGTH_SHARE * lengths[best]]
    is_clear = parallax_px > _SEEN_PX and others.max(initial=0.0) < _AS_GOOD_SHARE * fits[best]
    if not (is_expected or is_clear):
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
        piece = self.view.piece[visible]
        return float(normalised(self.view.levels[visible], piece) @ normalised(seen[visible], piece))

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


def _high_pass(grey: Image) -> Float32:
    return high_pass(grey, round(scaled(_BLUR_PX, grey.shape[0])) | 1)


def _at_peak(picture: _Picture, length_m: float, small_m: float) -> RoadMotion | None:
    """The motion at the best length for the assumed pitch, with the correction of the pitch."""
    at = picture.seen(length_m, 0.0)
    moved = [picture.seen(length_m + s * small_m, 0.0) for s in (-1, 1)]
    tilted = [picture.seen(length_m, s * _SMALL_PITCH) for s in (-1, 1)]
    visible = np.all([mask for _, mask in (at, *moved, *tilted)], axis=0)
    if int(np.sum(visible)) < _LEAST_PIXELS:
        return None
    block, piece = picture.view.block[visible], picture.view.piece[visible]
    key, now = (normalised(levels[visible], piece) for levels in (picture.view.levels, at[0]))
    if _agreeing(key, now, block) < _LEAST_AGREEING:
        return None
    residual = key - now
    J = np.stack(
        [
            (normalised(after[visible], piece) - normalised(before[visible], piece)) / (2 * small)
            for ((before, _), (after, _)), small in ((moved, small_m), (tilted, _SMALL_PITCH))
        ],
        axis=-1,
    )
    N = J.T @ J
    per_pixel = float(residual @ residual) / len(residual) * picture.view.alike
    determinant = float(np.linalg.det(N))
    if N[0, 0] <= 0 or determinant <= 1e-9 * N[0, 0] * N[1, 1]:
        return None
    small = np.linalg.solve(N, J.T @ residual)
    pulls = np.bincount(block, J[:, 0] * (residual - J @ small)) / N[0, 0]
    variance = max(per_pixel / float(N[0, 0]), float(pulls @ pulls) * _spread_factor(block))
    pitch_variance = per_pixel * float(N[0, 0]) / determinant
    return RoadMotion(length_m, variance, -float(N[0, 1] / N[0, 0]), float(small[1]), pitch_variance)


def _agreeing(key: Float, now: Float, block: NDArray[np.intp]) -> float:
    """Share of the texture of (M,) levels in blocks whose levels correlate in both images."""
    power, other, both = (np.bincount(block, product) for product in (key**2, now**2, key * now))
    return float(power[both > _LEAST_CORRELATION * np.sqrt(power * other)].sum() / power.sum())


def _spread_factor(block: NDArray[np.intp]) -> float:
    """Correction of a sum of squares over few blocks."""
    count = len(np.unique(block))
    return count / max(count - 1, 1)


def normalised(levels: Float32, piece: NDArray[np.intp]) -> Float:
    """(M,) with zero mean in each piece of a strip, and unit length; zeros where all are equal."""
    means = np.bincount(piece, levels) / np.maximum(np.bincount(piece), 1)
    centred = levels - means[piece]
    return centred / max(float(np.linalg.norm(centred)), 1e-9)
