"""The columns of the tables: a row per frame and a row per detection. Units are in the names."""

from dataclasses import dataclass
from typing import Any, Final

Columns = dict[str, Any]
"""Some of a row's columns, by name."""
TIME_COLUMNS: Final = tuple(
    f"{stage}_ms"
    for stage in ("decode", "surface", "lanes", "objects", "stereo", "odometry", "occupancy", "encode", "total")
)
"""Milliseconds each stage took; null where it did not run."""


@dataclass(frozen=True)
class FrameMetrics:
    """The row of a frame: DESIGN's columns, the times excepted. Units are in the names."""

    log_id: str
    frame: int
    stamp_ns: int
    surface_inlier_ratio: float | None = None
    camera_height_m: float | None = None
    camera_pitch_deg: float | None = None
    camera_roll_deg: float | None = None
    drivable_ratio: float | None = None
    surface_source: str | None = None
    lane_left_status: str | None = None
    lane_left_offset_m: float | None = None
    lane_left_raw_offset_m: float | None = None
    lane_left_boundary_class: str | None = None
    lane_right_status: str | None = None
    lane_right_offset_m: float | None = None
    lane_right_raw_offset_m: float | None = None
    lane_right_boundary_class: str | None = None
    lane_width_m: float | None = None
    lane_heading_deg: float | None = None
    lane_proposals: int | None = None
    lane_merged: int | None = None
    detections: int | None = None
    detections_kept: int | None = None
    detections_unjudged: int | None = None
    objects_carried: int | None = None
    nearest_object_m: float | None = None
    nearest_object_class: str | None = None
    time_to_impact_s: float | None = None
    time_to_impact_std_s: float | None = None
    stereo_valid_ratio: float | None = None
    stereo_nearest_m: float | None = None
    odometry_status: str | None = None
    odometry_inliers: int | None = None
    step_m: float | None = None
    turn_deg: float | None = None
    odom_x_m: float | None = None
    odom_y_m: float | None = None
    odom_z_m: float | None = None
    odom_qx: float | None = None
    odom_qy: float | None = None
    odom_qz: float | None = None
    odom_qw: float | None = None
    surface_angle_error_deg: float | None = None
    camera_height_error_m: float | None = None
    surface_height_error_m: float | None = None
    drivable_iou: float | None = None
    lane_left_error_m: float | None = None
    lane_right_error_m: float | None = None
    lane_left_true_offset_m: float | None = None
    lane_right_true_offset_m: float | None = None
    lane_tusimple_accuracy: float | None = None
    lane_tusimple_fp: float | None = None
    lane_tusimple_fn: float | None = None
    lane_culane_tp_50: int | None = None
    lane_culane_fp_50: int | None = None
    lane_culane_fn_50: int | None = None
    lane_culane_tp_30: int | None = None
    lane_culane_fp_30: int | None = None
    lane_culane_fn_30: int | None = None
    object_distance_error_m: float | None = None
    filter_tp: int | None = None
    filter_fp: int | None = None
    filter_fn: int | None = None
    filter_tn: int | None = None
    filter_precision: float | None = None
    filter_recall: float | None = None
    stereo_epe_px: float | None = None
    stereo_d1_ratio: float | None = None
    stereo_abs_rel: float | None = None
    stereo_coverage: float | None = None
    step_error_m: float | None = None
    turn_error_deg: float | None = None
    true_x_m: float | None = None
    true_y_m: float | None = None
    true_z_m: float | None = None
    true_qx: float | None = None
    true_qy: float | None = None
    true_qz: float | None = None
    true_qw: float | None = None
    sync_skew_ms: float | None = None
    missing: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class ObjectMetrics:
    """The row of a detection."""

    log_id: str
    frame: int
    stamp_ns: int
    track_id: str | None
    label: str
    score: float
    x_min_px: float
    y_min_px: float
    x_max_px: float
    y_max_px: float
    class_ratio: float | None
    kept: bool
    distance_m: float | None
    distance_std_m: float | None
    closing_speed_mps: float | None
    closing_speed_std_mps: float | None
    time_to_impact_s: float | None
    time_to_impact_std_s: float | None
    status: str
    beyond_range: bool
    is_true: bool | None
    true_distance_m: float | None
    true_closing_speed_mps: float | None
    true_time_to_impact_s: float | None
