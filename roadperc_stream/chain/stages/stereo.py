"""Depth from a stereo pair, Z = f b / d: rectify if needed, match, and rotate back to the mounted camera.

Method: semi-global matching (Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, PAMI
2008), with the costs of Birchfield and Tomasi, in OpenCV's StereoSGBM. Its three-direction form is as accurate on the
rendered scenes as eight directions, in a third of the time. Its disparities are biased towards whole pixels: at half
resolution this changes large distances by 5 %. One step of Lucas and Kanade (An Iterative Image Registration Technique,
1981) along the rows removes most of that error.
"""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from roadperc_stream.config import StereoConfig
from roadperc_stream.geometry import Float, Float32, Plane, inverse, rigid, transform_plane
from roadperc_stream.geometry.cameras import Camera, project, rays
from roadperc_stream.geometry.rectification import lens_fault, lens_of, rectification_maps, resampled, rotation_of
from roadperc_stream.kernels import doubled, refined_disparities
from roadperc_stream.model import Absent, Image, Mask, Reason, StereoDepth

_MULTIPLE: Final = 16
"""OpenCV searches a multiple of this number of disparities."""
_SUBPIXELS: Final = 16
"""OpenCV gives disparities in sixteenths of a pixel."""
_LEFT_RIGHT_PX: Final = 1
"""Largest difference between the left and the right disparity of a point, in pixels of the matched image."""
_SPECKLE_STEP_PX: Final = 2
"""Largest difference between neighbouring disparities of one patch, in pixels of the matched image."""
_STEP_PX: Final = 1.0
"""Difference of neighbouring disparities, in pixels of the image, from which they belong to two objects."""
_BASELINES_M: Final = (1e-3, 1e3)
"""Shortest and longest plausible distance between the cameras of a pair."""
_DISPARITY_STD_PX: Final = 0.5
"""Standard deviation of an object's disparity: wrong matches are similar at neighbouring pixels, so no mean removes it.

Measured on rendered objects from 10 to 100 m, with ``fast`` at 640x480.
"""
_END_PX: Final = 4.0
_MOST_AT_END: Final = 0.002
"""Largest share of pixels at the end of the range, which is this many pixels wide."""
_NEARER: Final = 1.1
"""Factor for points nearer than the road: bumps, and the pitch of a braking car."""


def match(
    cfg: StereoConfig,
    left: Camera,
    right: Camera,
    ego_T_left: Float,
    left_image: Image | None,
    right_image: Image | None,
) -> StereoDepth | Absent:
    """Depth of a stereo pair in the left camera's image, with its rectified intrinsics and its mounted rotation.

    ``cfg.method`` is not ``off``. The images are (H, W) grey, None if they could not be decoded. ``ego_T_left`` is the
    mounting of the left camera; the nearest road pixel sets the number of disparities.

    Returns:
        (H, W) float32 metres along z. NaN: hidden from the right camera, outside its image, ambiguous, or so far away
        that the disparity is mostly error. ``Absent`` if the pair cannot be matched.
    """
    if left_image is None:
        return Absent(Reason("stereo", "no_left_no_right_image" if right_image is None else "no_left_image"))
    if right_image is None:
        return Absent(Reason("stereo", "no_right_image"))
    baseline_m = right.baseline_m
    if baseline_m is None:
        return Absent(Reason("stereo", "no_baseline", _BASELINES_M))
    fault = _fault(left, right, baseline_m, left_image, right_image)
    if fault is not None:
        return Absent(fault)
    ego_T_rectified = ego_T_left @ rigid(rotation_of(left).T, np.zeros(3))
    count = disparities_needed(left, baseline_m, ego_T_rectified) if cfg.disparities == "auto" else cfg.disparities
    if count is None:
        return Absent(Reason("stereo", "camera_below_road"))
    if cfg.method == "fast":
        count = 2 * rounded_up(count / 2)
    disparity_px = _rectified_disparity(cfg, count, left, right, left_image, right_image)
    depth_m = depth_of(cfg, left, baseline_m, turned_back(left, disparity_px))
    return StereoDepth(left.frame_id, depth_m, _DISPARITY_STD_PX / (left.fx * baseline_m))


def _fault(left: Camera, right: Camera, baseline_m: float, left_image: Image, right_image: Image) -> Reason | None:
    """The reason why the two images cannot be matched; None if they can."""
    if not _BASELINES_M[0] <= baseline_m <= _BASELINES_M[1]:
        return Reason("stereo", "wrong_baseline", (baseline_m, *_BASELINES_M))
    if left.size != right.size:
        return Reason("stereo", "pair_of_two_sizes", (left.width, left.height, right.width, right.height))
    for side, camera, image in (("left", left, left_image), ("right", right, right_image)):
        if image.shape != camera.size:
            return Reason("stereo", "pair_of_wrong_size", (side, *image.shape[::-1], camera.width, camera.height))
        fault = _lens_fault(side, camera)
        if fault is not None:
            return fault
    return None


def _lens_fault(side: str, camera: Camera) -> Reason | None:
    """The reason why a camera's images cannot be rectified; None if they can be, or need not be."""
    if not lens_of(camera).R:
        return Reason("stereo", "lens_without_rotation", (side,))
    fault = lens_fault(camera)
    return None if fault is None else Reason("stereo", fault[0], (side, *fault[1]))


def disparities_needed(left: Camera, baseline_m: float, ego_T_rectified: Float) -> int | None:
    """Number of disparities up to that of the nearest road pixel: a multiple of 16, limited by the image's width.

    On a plane the disparity is linear in the pixel, d = -f b (n . ray) / height, so the largest one is in a corner.
    None if the mounting puts the camera below the road.
    """
    road = transform_plane(inverse(ego_T_rectified), Plane.of(np.array([0.0, 0.0, 1.0]), 0.0))
    if road.offset_m <= 0:
        return None
    right, bottom = left.width - 1.0, left.height - 1.0
    corners = rays(left, np.array([[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]]))
    disparity_px = left.fx * baseline_m * float(np.max(-corners @ road.n)) / road.offset_m
    return rounded_up(min(_NEARER * disparity_px, left.width))


def rounded_up(count: float) -> int:
    """The next multiple of 16, as OpenCV requires for the number of disparities."""
    return max(int(np.ceil(count / _MULTIPLE)), 1) * _MULTIPLE


def _rectified_disparity(
    cfg: StereoConfig, count: int, left: Camera, right: Camera, left_grey: Image, right_grey: Image
) -> Float32:
    """(H, W) disparities of pixels visible to both cameras; unrectified images are resampled first."""
    left_valid = right_valid = None
    if left.lens is not None or right.lens is not None or not right.same_view(left):
        left_valid, right_valid = (rectification_maps(camera, left)[2] for camera in (left, right))
        left_grey, right_grey = resampled(left, left, left_grey), resampled(right, left, right_grey)
    disparity_px = _within_range(cfg, count, left_grey, right_grey)
    if left_valid is not None:
        disparity_px[~left_valid] = np.nan
    disparity_px[_hidden_from_right(disparity_px, right_valid)] = np.nan
    return disparity_px


def _within_range(cfg: StereoConfig, count: int, left: Image, right: Image) -> Float32:
    """(H, W) disparities of a rectified pair, NaN at the end of the range: there the true one may be larger.

    With ``auto``, the range is doubled while many pixels are at its end: something stands before the nearest road.
    """
    while True:
        disparity_px = disparity(cfg, count, left, right)
        at_end = disparity_px > np.float32(count - _END_PX)
        is_wide = cfg.disparities != "auto" or count >= left.shape[1]
        if is_wide or np.count_nonzero(at_end) <= _MOST_AT_END * at_end.size:
            disparity_px[at_end] = np.nan
            return disparity_px
        count *= 2


def _hidden_from_right(disparity_px: Float32, right_valid: Mask | None) -> Mask:
    """(H, W) pixels whose partner is unknown, outside the right image, or one of its pixels that are not valid."""
    columns = np.arange(disparity_px.shape[1], dtype=np.float32)
    with np.errstate(invalid="ignore"):
        inside = disparity_px <= columns
    if right_valid is not None:
        partner = np.rint(np.where(inside, columns - disparity_px, 0)).astype(np.intp)
        inside &= np.take_along_axis(right_valid, partner, axis=1)
    return ~inside


def disparity(cfg: StereoConfig, count: int, left: Image, right: Image) -> Float32:
    """(H, W) float32 disparities of a rectified (H, W) grey pair: left column minus right column, NaN unknown.

    ``count`` is the number of searched disparities, from 0: a multiple of 16, or of 32 with ``fast``. ``cfg.method``
    is not ``off``; with ``full`` and without refinement, disparities are multiples of 1/16 pixel.
    """
    if cfg.method == "full":
        return _found(cfg, count, left, right)
    height, width = left.shape
    left, right = _halved(left), _halved(right)
    return doubled(_found(cfg, count // 2, left, right), _STEP_PX)[:height, :width]


def _found(cfg: StereoConfig, count: int, left: Image, right: Image) -> Float32:
    """(H, W) disparities in pixels of these images, refined with ``refine_px``; NaN unknown.

    OpenCV marks unknown pixels with -1, and returns 0 where all disparities fit equally. It finds no disparity in the
    first ``count`` columns, so both images are padded by as many columns. For 192 of 1280 columns this takes a quarter
    more time.
    """
    wide = [cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    sixteenths = np.asarray(matcher_of(cfg, count).compute(*wide), np.int16)[:, count:]
    if cfg.refine_px:
        return refined_disparities(sixteenths, left, right, cfg.refine_px)
    return np.where(sixteenths > 0, sixteenths * np.float32(1 / _SUBPIXELS), np.float32(np.nan))


def matcher_of(cfg: StereoConfig, count: int) -> cv2.StereoSGBM:
    """OpenCV's matcher with the settings, for a number of disparities that is a multiple of 16."""
    return cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=cfg.block_px,
        P1=cfg.p1,
        P2=cfg.p2,
        disp12MaxDiff=_LEFT_RIGHT_PX,
        uniquenessRatio=cfg.uniqueness_percent,
        speckleWindowSize=cfg.speckle_px,
        speckleRange=_SPECKLE_STEP_PX,
        mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    )


def _halved(image: Image) -> Image:
    """Means of two by two pixels; an odd last row or column counts twice."""
    height, width = image.shape
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def turned_back(left: Camera, disparity_px: Float32) -> Float32:
    """Rotate (H, W) disparities f b / z of the rectified camera back to the pixels of the left camera.

    Both cameras have the same centre, so there is no occlusion: each pixel's ray samples the rectified pixel it hits.
    At the border of two objects it takes the nearest pixel, because interpolation would give a point in mid-air.
    """
    if np.array_equal(rotation_of(left), np.eye(3)):
        return disparity_px
    columns, rows, z = _turned_rays(left)
    nearest, smooth = (
        np.asarray(cv2.remap(disparity_px, columns, rows, interpolation, borderValue=np.nan), np.float32)
        for interpolation in (cv2.INTER_NEAREST, cv2.INTER_LINEAR)
    )
    with np.errstate(invalid="ignore"):
        same_object = np.abs(smooth - nearest) < np.float32(_STEP_PX)
    return np.where(same_object, smooth, nearest) * z


@lru_cache(maxsize=4)
def _turned_rays(left: Camera) -> tuple[Float32, Float32, Float32]:
    """(H, W) columns and rows in the rectified camera of the left camera's pixels, and z of their rays there."""
    rows, columns = np.indices(left.size, dtype=float)
    turned = rays(left, np.stack((columns, rows), axis=-1)) @ rotation_of(left).T
    pixels = project(left, turned).astype(np.float32)
    return pixels[..., 0], pixels[..., 1], turned[..., 2].astype(np.float32)


def depth_of(cfg: StereoConfig, left: Camera, baseline_m: float, disparity_px: Float32) -> Float32:
    """(H, W) metres along z of (H, W) disparities in pixels; NaN below ``min_disparity_px`` and where unknown."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        depth_m = np.divide(np.float32(left.fx * baseline_m), disparity_px)
        np.copyto(depth_m, np.float32(np.nan), where=~(disparity_px >= np.float32(cfg.min_disparity_px)))
    return depth_m
