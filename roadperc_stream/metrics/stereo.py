"""How each stereo depth is filled, and how far it is off."""

import numpy as np

from roadperc_stream.core.datatypes import Absent, Sample, StereoDepth
from roadperc_stream.errors import DecodeError
from roadperc_stream.metrics.stereo_errors import stereo_errors
from roadperc_stream.schemas.columns.errors import StereoErrorColumns
from roadperc_stream.schemas.columns.estimates import StereoColumns

STEREO_NEAREST_QUANTILE = 0.02


def stereo_columns(stereo: StereoDepth | Absent) -> StereoColumns:
    """How much of the image has a stereo depth, and how near the nearest is."""
    if isinstance(stereo, Absent):
        return StereoColumns()
    known = stereo.depth_m[np.isfinite(stereo.depth_m)]
    nearest = float(np.quantile(known, STEREO_NEAREST_QUANTILE)) if len(known) else None
    return StereoColumns(stereo_valid_ratio=len(known) / stereo.depth_m.size, stereo_nearest_m=nearest)


def stereo_errors_of(stereo: StereoDepth | Absent, sample: Sample) -> StereoErrorColumns:
    """Against the front depth, where it is the left camera that has both."""
    frame = sample.frame
    depth = sample.truth.depth or frame.depth
    if isinstance(stereo, Absent) or depth is None or frame.right_camera is None or frame.left is not None:
        return StereoErrorColumns()
    try:
        true_m = depth.depth_m
    except DecodeError:
        return StereoErrorColumns()
    baseline_m = frame.right_camera.baseline_m
    if not baseline_m or depth.frame_id != frame.camera.frame_id or true_m.shape != stereo.depth_m.shape:
        return StereoErrorColumns()
    errors = stereo_errors(stereo.depth_m, true_m, frame.camera, baseline_m)
    return StereoErrorColumns(
        stereo_epe_px=errors.epe_px,
        stereo_d1_ratio=errors.d1_ratio,
        stereo_abs_rel=errors.abs_rel,
        stereo_coverage=errors.coverage,
    )
