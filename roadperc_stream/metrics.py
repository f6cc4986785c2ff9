"""One row of numbers per frame and one per detection: pure functions of what the chain made and what is true.

An error is estimate minus truth; a column is None where it could not be measured.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.config import ReplayConfig
from roadperc_stream.datatypes import (
    Absent,
    Boundary,
    FrameResult,
    Lanes,
    Mask,
    Object,
    Objects,
    Odometry,
    Sample,
    StereoDepth,
    Surface,
    Truth,
)
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Float, angle_between, inverse, quaternion
from roadperc_stream.ground import height_at
from roadperc_stream.rows import FrameMetrics, ObjectMetrics
from roadperc_stream.stages.surface import drivable_mask
from roadperc_stream.stereo_errors import stereo_errors

LANE_ERROR_AT_M = 10.0
STEREO_NEAREST_QUANTILE = 0.02
HEIGHT_ERROR_FROM_M, HEIGHT_ERROR_TO_M, HEIGHT_ERROR_ASIDE_M = 5.0, 40.0, 4.0
"""Ego x from and to which heights are judged, and how far to either side."""
MATCH_OVERLAP = 0.5
"""Intersection over union from which a detection stands for a true object."""


def frame_metrics(
    cfg: ReplayConfig, log_id: str, sample: Sample, result: FrameResult, previous: Sample | None = None
) -> FrameMetrics:
    """The row of one frame, with errors wherever the log carries truth; ``previous`` is the frame before."""
    return FrameMetrics(
        log_id=log_id,
        frame=sample.index,
        stamp_ns=result.stamp_ns,
        sync_skew_ms=None if sample.skew_ns is None else sample.skew_ns / 1e6,
        missing=sample.missing,
        reasons=(*(f"{role}: no message at this frame" for role in sample.missing), *result.reasons()),
        **_surface_columns(result),
        **_lane_columns(result.lanes),
        **_object_columns(result.objects),
        **_stereo_columns(result.stereo),
        **_odometry_columns(result.odometry),
        **_surface_errors(cfg, result, sample),
        **_lane_errors(result.lanes, sample.truth.lanes),
        **_object_errors(result.objects, sample.truth.objects),
        **_stereo_errors(result.stereo, sample),
        **_odometry_errors(result.odometry, sample, previous),
    )


def object_metrics(log_id: str, sample: Sample, result: FrameResult) -> list[ObjectMetrics]:
    """The rows of a frame's detections, kept and dropped."""
    if isinstance(result.objects, Absent):
        return []
    objects = result.objects.objects
    true_distances = _true_distances(objects, sample.truth.objects)
    return [_object_row(log_id, sample, item, true_m) for item, true_m in zip(objects, true_distances, strict=True)]


def _object_row(log_id: str, sample: Sample, item: Object, true_distance_m: float | None) -> ObjectMetrics:
    box = item.detection.box_px
    return ObjectMetrics(
        log_id,
        sample.index,
        sample.frame.stamp_ns,
        item.track_id or None,
        item.detection.label,
        item.detection.score,
        box.x_min,
        box.y_min,
        box.x_max,
        box.y_max,
        item.class_ratio,
        item.kept,
        item.distance_m,
        item.distance_std_m,
        item.closing_speed_mps,
        item.closing_speed_std_mps,
        item.time_to_impact_s,
        item.time_to_impact_std_s,
        item.status,
        item.beyond_range,
        true_distance_m,
    )


Columns = dict[str, Any]


def _surface_columns(result: FrameResult) -> Columns:
    columns: Columns = {}
    if not isinstance(result.surface, Absent):
        surface = result.surface
        columns |= {
            "surface_inlier_ratio": surface.inlier_ratio,
            "surface_source": surface.source,
            "camera_height_m": surface.camera_height_m,
            "camera_pitch_deg": float(np.degrees(surface.pitch)),
            "camera_roll_deg": float(np.degrees(surface.roll)),
        }
    if not isinstance(result.drivable, Absent):
        columns["drivable_ratio"] = float(result.drivable.mean())
    return columns


def _lane_columns(lanes: Lanes | Absent) -> Columns:
    if isinstance(lanes, Absent):
        return {}
    left, right = lanes.side("left"), lanes.side("right")
    columns: Columns = {"lane_proposals": len(lanes.proposals_px), "lane_merged": len(lanes.merged_px)}
    for boundary in (left, right):
        prefix = f"lane_{boundary.side}"
        columns[f"{prefix}_status"] = boundary.status
        columns[f"{prefix}_offset_m"] = boundary.offset_m
        columns[f"{prefix}_raw_offset_m"] = boundary.raw_offset_m
        columns[f"{prefix}_boundary_class"] = boundary.outside or None
    if left.offset_m is not None and right.offset_m is not None:
        columns["lane_width_m"] = left.offset_m - right.offset_m
    headings = [boundary.heading for boundary in (left, right) if boundary.heading is not None]
    if headings:
        columns["lane_heading_deg"] = float(np.degrees(np.mean(headings)))
    return columns


def _object_columns(objects: Objects | Absent) -> Columns:
    if isinstance(objects, Absent):
        return {}
    kept = [item for item in objects.objects if item.kept]
    known = [(item.distance_m, item.detection.label) for item in kept if item.distance_m is not None]
    nearest_m, nearest_class = min(known, default=(None, None))
    impacts = [(i.time_to_impact_s, i.time_to_impact_std_s) for i in kept if i.time_to_impact_s is not None]
    soonest_s, soonest_std_s = min(impacts, key=lambda impact: impact[0], default=(None, None))
    return {
        "detections": sum(item.status == "measured" for item in objects.objects),
        "detections_kept": sum(item.status == "measured" for item in kept),
        "objects_carried": sum(item.status == "tracked" for item in kept),
        "detections_unjudged": sum(item.kept and item.class_ratio is None for item in objects.objects),
        "nearest_object_m": nearest_m,
        "nearest_object_class": nearest_class,
        "time_to_impact_s": soonest_s,
        "time_to_impact_std_s": soonest_std_s,
    }


def _stereo_columns(stereo: StereoDepth | Absent) -> Columns:
    if isinstance(stereo, Absent):
        return {}
    known = stereo.depth_m[np.isfinite(stereo.depth_m)]
    nearest = float(np.quantile(known, STEREO_NEAREST_QUANTILE)) if len(known) else None
    return {"stereo_valid_ratio": len(known) / stereo.depth_m.size, "stereo_nearest_m": nearest}


def _stereo_errors(stereo: StereoDepth | Absent, sample: Sample) -> Columns:
    """Against the front depth, where it is the left camera that has both."""
    frame = sample.frame
    depth = sample.truth.depth or frame.depth
    if isinstance(stereo, Absent) or depth is None or frame.right_camera is None or frame.left is not None:
        return {}
    try:
        true_m = depth.depth_m
    except DecodeError:
        return {}
    baseline_m = frame.right_camera.baseline_m
    if not baseline_m or depth.frame_id != frame.camera.frame_id or true_m.shape != stereo.depth_m.shape:
        return {}
    errors = stereo_errors(stereo.depth_m, true_m, frame.camera, baseline_m)
    return {"stereo_epe_px": errors.epe_px, "stereo_d1_ratio": errors.d1_ratio}


def _odometry_columns(odometry: Odometry | Absent) -> Columns:
    if isinstance(odometry, Absent):
        return {}
    x, y, z = (float(value) for value in odometry.odom_T_ego[:3, 3])
    qx, qy, qz, qw = quaternion(odometry.odom_T_ego[:3, :3])
    columns: Columns = {
        "odometry_status": odometry.status,
        "odometry_inliers": odometry.inliers,
        "odom_x_m": x,
        "odom_y_m": y,
        "odom_z_m": z,
        "odom_qx": qx,
        "odom_qy": qy,
        "odom_qz": qz,
        "odom_qw": qw,
    }
    if odometry.step is not None:
        columns["turn_deg"] = rotation_angle_deg(odometry.step)
        columns["step_m"] = None if odometry.up_to_scale else float(np.linalg.norm(odometry.step[:3, 3]))
    return columns


def _odometry_errors(odometry: Odometry | Absent, sample: Sample, previous: Sample | None) -> Columns:
    """What is left of the step when the true one is undone: its length and its angle."""
    if isinstance(odometry, Absent) or odometry.step is None or previous is None:
        return {}
    before, now = previous.truth.odom_T_ego, sample.truth.odom_T_ego
    if before is None or now is None or odometry.since_ns != previous.frame.stamp_ns:
        return {}
    left = inverse(inverse(before) @ now) @ odometry.step
    columns: Columns = {"turn_error_deg": rotation_angle_deg(left)}
    if not odometry.up_to_scale:
        columns["step_error_m"] = float(np.linalg.norm(left[:3, 3]))
    return columns


def rotation_angle_deg(transform: Float) -> float:
    """Angle of a (4, 4) transform's rotation, degrees; accurate for small angles."""
    return float(np.degrees(Rotation.from_matrix(transform[:3, :3]).magnitude()))


def _surface_errors(cfg: ReplayConfig, result: FrameResult, sample: Sample) -> Columns:
    columns: Columns = {}
    truth = sample.truth
    if truth.surface is not None and not isinstance(result.surface, Absent):
        angle = angle_between(result.surface.ego_plane.n, truth.surface.ego_plane.n)
        columns["surface_angle_error_deg"] = float(np.degrees(angle))
        columns["surface_height_error_m"] = surface_height_error_m(result.surface, truth.surface)
        columns["camera_height_error_m"] = result.surface.camera_height_m - truth.surface.camera_height_m
    true_mask = _true_drivable(cfg, truth, sample)
    if true_mask is not None and not isinstance(result.drivable, Absent):
        columns["drivable_iou"] = intersection_over_union(result.drivable, true_mask)
    return columns


def surface_height_error_m(surface: Surface, truth: Surface) -> float | None:
    """Median absolute height error of the road ahead (``HEIGHT_ERROR_FROM_M`` to ``HEIGHT_ERROR_TO_M``), metres.

    Taken at the nodes of the truth's height grid; None where the truth has no grid, or none there.
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


def _true_drivable(cfg: ReplayConfig, truth: Truth, sample: Sample) -> Mask | None:
    """Drivable pixels by the clean tags, depth and plane; None where the log does not carry them.

    The tags are never those the chain saw. Where only these were spoilt there is no clean depth beside the log's own,
    which is then true as it stands.
    """
    depth = truth.depth or sample.frame.depth
    if truth.segmentation is None or depth is None or truth.surface is None:
        return None
    try:
        road = truth.segmentation.table.lookup(cfg.surface.classes)[truth.segmentation.tags]
        depth_m = depth.depth_m
    except DecodeError:
        return None
    camera = sample.frame.camera
    if road.shape != camera.size or depth_m.shape != camera.size:
        return None
    mask = drivable_mask(cfg.surface, truth.surface, camera, depth_m, road, sample.frame.ego_T_camera)
    return None if isinstance(mask, Absent) else mask


def intersection_over_union(mask: Mask, truth: Mask) -> float | None:
    """|A and B| / |A or B| of two (H, W) masks; None where both are empty or their shapes differ."""
    if mask.shape != truth.shape:
        return None
    union = int(np.count_nonzero(mask | truth))
    return int(np.count_nonzero(mask & truth)) / union if union else None


def _lane_errors(lanes: Lanes | Absent, truth: Lanes | None) -> Columns:
    if isinstance(lanes, Absent) or truth is None:
        return {}
    return {f"lane_{side}_error_m": lane_error_m(lanes.side(side), truth.side(side)) for side in ("left", "right")}


def lane_error_m(boundary: Boundary, truth: Boundary) -> float | None:
    """Lateral error ``LANE_ERROR_AT_M`` ahead (ego x), metres; positive where the estimate lies farther left."""
    x = LANE_ERROR_AT_M
    line = truth.line_ego_m
    if boundary.offset_m is None or boundary.heading is None or boundary.curvature_per_m is None:
        return None
    if len(line) < 2 or not line[0, 0] <= x <= line[-1, 0]:
        return None
    y = boundary.offset_m + boundary.heading * x + 0.5 * boundary.curvature_per_m * x**2
    return float(y - np.interp(x, line[:, 0], line[:, 1]))


def _object_errors(objects: Objects | Absent, truth: Objects | None) -> Columns:
    if isinstance(objects, Absent):
        return {}
    pairs = zip(objects.objects, _true_distances(objects.objects, truth), strict=True)
    errors = [
        abs(item.distance_m - true_m)
        for item, true_m in pairs
        if item.kept and item.distance_m is not None and true_m is not None
    ]
    return {"object_distance_error_m": float(np.mean(errors)) if errors else None}


def _true_distances(objects: Sequence[Object], truth: Objects | None) -> list[float | None]:
    """Distance of the true object each detection stands for: pairs by overlap, the best first, each used once."""
    distances: list[float | None] = [None] * len(objects)
    if truth is None:
        return distances
    pairs = sorted(
        (
            (item.detection.box_px.overlap(true.detection.box_px), i, k)
            for i, item in enumerate(objects)
            for k, true in enumerate(truth.objects)
            if item.detection.box_px.overlap(true.detection.box_px) >= MATCH_OVERLAP
        ),
        key=lambda pair: (-pair[0], pair[1], pair[2]),
    )
    used_items: set[int] = set()
    used_truths: set[int] = set()
    for _, i, k in pairs:
        if i not in used_items and k not in used_truths:
            distances[i] = truth.objects[k].distance_m
            used_items.add(i)
            used_truths.add(k)
    return distances
