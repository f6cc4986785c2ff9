"""Metrics of stereo depth where both cameras see: coverage, KITTI's end-point error and D1, and relative error."""

from typing import Final

import numpy as np

from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, Float32
from roadperc_stream.geometry.rectification import rectified
from roadperc_stream.kernels import disparity_errors, seen_by_both
from roadperc_stream.kernels.stereo_plain import DisparityLimits
from roadperc_stream.model import Absent, Sample, StereoDepth
from roadperc_stream.schemas.columns.errors import StereoErrorColumns
from roadperc_stream.schemas.columns.estimates import StereoColumns

STEREO_NEAREST_QUANTILE: Final = 0.02
STEREO_MAX_DEPTH_M: Final = 60.0
D1_PX: Final = 3.0
D1_SHARE: Final = 0.05
OCCLUSION_PX: Final = 1.0
"""Disparity difference from which a nearer pixel hides another one in the right image."""
_SAMPLED: Final = 64
"""The sample takes one of this many numbers."""


def stereo_columns(stereo: StereoDepth | Absent) -> StereoColumns:
    """The share of the image with stereo depth, and the nearest depth."""
    if isinstance(stereo, Absent):
        return StereoColumns()
    known = stereo.depth_m[np.isfinite(stereo.depth_m)]
    nearest = low_quantile(known, STEREO_NEAREST_QUANTILE) if len(known) else None
    return StereoColumns(stereo_valid_ratio=len(known) / stereo.depth_m.size, stereo_nearest_m=nearest)


def stereo_errors_of(stereo: StereoDepth | Absent, sample: Sample) -> StereoErrorColumns:
    """Errors against the front depth; empty columns unless the front camera is the left one."""
    frame = sample.frame
    depth = sample.truth.depth or frame.depth_image
    is_front = frame.left is None or rectified(frame.left_camera) == frame.camera
    if isinstance(stereo, Absent) or depth is None or frame.right_camera is None or not is_front:
        return StereoErrorColumns()
    try:
        true_m = depth.depth_m
    except DecodeError:
        return StereoErrorColumns()
    baseline_m = frame.right_camera.baseline_m
    if not baseline_m or depth.frame_id != frame.camera.frame_id or true_m.shape != stereo.depth_m.shape:
        return StereoErrorColumns()
    return stereo_errors(stereo.depth_m, true_m, frame.camera, baseline_m)


def stereo_errors(estimated_m: Float32, true_m: Float32, camera: Camera, baseline_m: float) -> StereoErrorColumns:
    """End-point error and D1 of a stereo depth, by the definitions of the KITTI 2015 benchmark (non-occluded pixels).

    The end-point error is the mean absolute error of the disparity f b / Z; D1 is the share of disparities more than 3
    px and more than 5 % off; the absolute relative error is the mean of |Z - Z*| / Z*. All are over known pixels, so
    read them with the coverage. Pixels with a true depth beyond ``STEREO_MAX_DEPTH_M`` do not count. ``estimated_m``
    and ``true_m`` are (H, W) metres along z of the left camera, NaN unknown. ``baseline_m`` is the distance of the
    right camera along the rows.

    Returns:
        The errors; None without counted pixels.
    """
    scale_px_m = float(np.float32(camera.fx * baseline_m))
    with np.errstate(divide="ignore"):
        true_px = np.float32(scale_px_m) / true_m
    limits = DisparityLimits(scale_px_m, STEREO_MAX_DEPTH_M, D1_PX, D1_SHARE)
    seen = seen_by_both(true_px, OCCLUSION_PX)
    error_px, relative, counted, bad = disparity_errors(estimated_m, true_m, seen, limits)
    if not len(error_px):
        return StereoErrorColumns(stereo_coverage=0.0 if counted else None)
    mean_px, mean_relative = (float(values.mean(dtype=float)) for values in (error_px, relative))
    return StereoErrorColumns(mean_px, bad / len(error_px), mean_relative, len(error_px) / counted)


def low_quantile(values: Float32, share: float) -> float:
    """Quantile of (N,) numbers, N > 0, with linear interpolation as in numpy, but faster for a small share.

    A sample gives a bound; only numbers below it are sorted.
    """
    at = share * (len(values) - 1)
    rank, between = int(at), at - int(at)
    sample = np.sort(values[::_SAMPLED])
    low = values[values <= sample[min(int(2 * share * len(sample)) + 1, len(sample) - 1)]]
    ordered = np.sort(low if len(low) > rank + 1 else values)
    below, above = ordered[rank], ordered[min(rank + 1, len(ordered) - 1)]
    step = above - below
    return float(below + step * between if between < 0.5 else above - step * (1 - between))
