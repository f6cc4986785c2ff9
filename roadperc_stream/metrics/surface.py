"""Metrics of the road's plane, its heights and the drivable pixels."""

import cv2
import numpy as np

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import angle_between
from roadperc_stream.geometry.ground import ego_points, height_above, height_at
from roadperc_stream.model import Absent, FrameResult, Mask, Sample, Surface
from roadperc_stream.model.frame import mark
from roadperc_stream.schemas.columns.errors import SurfaceErrorColumns
from roadperc_stream.schemas.columns.estimates import SurfaceColumns

HEIGHT_ERROR_FROM_M, HEIGHT_ERROR_TO_M, HEIGHT_ERROR_ASIDE_M = 5.0, 40.0, 4.0
"""Range of ego x, and distance to either side, in which heights are compared."""
TRUE_ROAD_M = 0.15
"""Largest height above or below the true road of a pixel that is truly drivable."""


def surface_columns(result: FrameResult) -> SurfaceColumns:
    """The road's plane, and the share of the image that is drivable."""
    surface, drivable = result.surface, result.drivable
    drivable_ratio = None if isinstance(drivable, Absent) else cv2.countNonZero(drivable.view(np.uint8)) / drivable.size
    if isinstance(surface, Absent):
        return SurfaceColumns(drivable_ratio=drivable_ratio)
    return SurfaceColumns(
        surface_inlier_ratio=surface.inlier_ratio,
        camera_height_m=surface.camera_height_m,
        camera_pitch_deg=float(np.degrees(surface.pitch)),
        camera_roll_deg=float(np.degrees(surface.roll)),
        drivable_ratio=drivable_ratio,
        surface_source=surface.source,
        surface_model=surface.model,
    )


def surface_errors(cfg: ReplayConfig, result: FrameResult, sample: Sample) -> SurfaceErrorColumns:
    """Errors of plane, heights and drivable pixels, if the log has their truth."""
    surface, truth = result.surface, sample.truth
    seen, true_mask = result.drivable, _true_drivable(cfg, sample)
    drivable_iou = None if isinstance(seen, Absent) or true_mask is None else intersection_over_union(seen, true_mask)
    if truth.surface is None or isinstance(surface, Absent):
        return SurfaceErrorColumns(drivable_iou=drivable_iou)
    return SurfaceErrorColumns(
        surface_angle_error_deg=float(np.degrees(angle_between(surface.ego_plane.n, truth.surface.ego_plane.n))),
        camera_height_error_m=surface.camera_height_m - truth.surface.camera_height_m,
        surface_height_error_m=surface_height_error_m(surface, truth.surface),
        drivable_iou=drivable_iou,
    )


def surface_height_error_m(surface: Surface, truth: Surface) -> float | None:
    """Median absolute height error of the road ahead (``HEIGHT_ERROR_FROM_M`` to ``HEIGHT_ERROR_TO_M``), metres.

    Taken at the nodes of the truth's height grid; None without a grid or without nodes in that range.
    """
    grid = truth.height_grid
    if grid is None:
        return None
    rows, columns = grid.z_m.shape
    x, y = grid.x_min_m + grid.step_m * np.arange(columns), grid.y_min_m + grid.step_m * np.arange(rows)
    ahead = (x >= HEIGHT_ERROR_FROM_M) & (x <= HEIGHT_ERROR_TO_M)
    aside = np.abs(y) < HEIGHT_ERROR_ASIDE_M
    true_z = grid.z_m[np.ix_(aside, ahead)].astype(float)
    error = np.abs(height_at(surface, *np.meshgrid(x[ahead], y[aside])) - true_z)
    return float(np.median(error)) if error.size else None


def _true_drivable(cfg: ReplayConfig, sample: Sample) -> Mask | None:
    """Pixels of a drivable true tag whose true point is near the true road; None if the log has no such truth.

    The tags are never the chain's input. A log without ``/truth/depth`` has clean depth itself. No code of the chain
    is used, so a fault of a stage does not cancel.
    """
    frame, truth = sample.frame, sample.truth
    depth = truth.depth or frame.depth_image
    if truth.segmentation is None or depth is None or truth.surface is None:
        return None
    try:
        tags, depth_m = truth.segmentation.tags, depth.depth_m
    except DecodeError:
        return None
    if tags.shape != frame.camera.size or depth_m.shape != frame.camera.size:
        return None
    drivable = mark(tags, truth.segmentation.table.lookup(cfg.surface.classes)).view(bool)
    first = int(drivable.argmax()) // drivable.shape[1]
    x, y, z = ego_points(frame.camera, frame.ego_T_camera, depth_m[first:], first)
    drivable[first:] &= np.abs(height_above(truth.surface, x, y, z)) < TRUE_ROAD_M  # unknown depth compares as False
    return drivable


def intersection_over_union(mask: Mask, truth: Mask) -> float | None:
    """|A and B| / |A or B| of two (H, W) masks; None if both are empty or their shapes differ."""
    if mask.shape != truth.shape:
        return None
    union = int(np.count_nonzero(mask | truth))
    return int(np.count_nonzero(mask & truth)) / union if union else None
