"""Columns that compare a frame's estimates with the truth, and columns of the truth itself."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

from roadperc_stream.schemas.columns.column import COUNT, RATIO, Column

_NO_TRUE_PLANE = "no plane, or no true one"
_score = partial(Column, better="low")
"""The column of a number that reports list and compare."""


@dataclass(frozen=True)
class SurfaceErrorColumns:
    """Errors of plane, heights and drivable pixels."""

    surface_angle_error_deg: Annotated[
        float | None,
        _score(
            "angle between the normals in the ego frame, atan2(norm(cross(n, n*)), dot(n, n*))",
            "deg",
            _NO_TRUE_PLANE,
            "surface angle error",
            4,
            limit=1.0,
        ),
    ] = None
    camera_height_error_m: Annotated[
        float | None,
        _score(
            "h - h*, the height of the depth's camera",
            "m",
            _NO_TRUE_PLANE,
            "camera height error",
            4,
            better="near 0",
            limit=0.1,
        ),
    ] = None
    surface_height_error_m: Annotated[
        float | None,
        _score(
            "median of abs(z - z*) at the true height grid's nodes with 5 m <= x <= 40 m and abs(y) < 4 m",
            "m",
            "no plane, or no true grid there",
            "road height error",
            4,
            limit=0.1,
        ),
    ] = None
    drivable_iou: Annotated[
        float | None,
        _score(
            "intersection over union with the pixels that have a drivable true tag within 0.15 m of the true road",
            RATIO,
            "a mask or the truth is missing; both masks empty",
            "drivable IoU",
            3,
            better="high",
            limit=0.9,
        ),
    ] = None


def _lane_error(side: str) -> Column:
    return _score(
        "y(10 m) - y*(10 m) in the ego frame, positive to the left, with y(x) = offset + heading x + curvature x² / 2",
        "m",
        "boundary lost, or the true line does not reach 10 m",
        f"lane {side} error at 10 m",
        3,
        better="near 0",
        limit=0.3,
    )


@dataclass(frozen=True)
class LaneErrorColumns:
    """Errors of the boundaries on the road."""

    lane_left_error_m: Annotated[float | None, _lane_error("left")] = None
    lane_right_error_m: Annotated[float | None, _lane_error("right")] = None


_TRUE_CLASS = Column("true class beyond the boundary", null="no true boundary or class")
_TRUE_OFFSET = Column("true lateral offset at x = 0", "m", "no true boundary")


@dataclass(frozen=True)
class TrueLaneColumns:
    """The true boundaries, for jitter and lag."""

    lane_left_true_offset_m: Annotated[float | None, _TRUE_OFFSET] = None
    lane_right_true_offset_m: Annotated[float | None, _TRUE_OFFSET] = None
    true_lane_change: Annotated[
        str | None,
        Column(
            "`left` or `right` while part of the car is truly over the line, else `none`",
            null="the log has no such truth",
        ),
    ] = None
    true_lane_changes: Annotated[
        int | None,
        Column("true number of lanes that the ego origin has entered", COUNT, "the log has no such truth"),
    ] = None
    lane_true_heading_deg: Annotated[
        float | None,
        Column(
            "true heading, the mean over the boundaries",
            "deg",
            "both boundaries lost, or no true heading",
        ),
    ] = None
    lane_left_true_boundary_class: Annotated[str | None, _TRUE_CLASS] = None
    lane_right_true_boundary_class: Annotated[str | None, _TRUE_CLASS] = None


def _culane(meaning: str) -> Column:
    return Column(f"{meaning} at an overlap above 0.5 or 0.3, lines drawn 30 px wide", COUNT)


@dataclass(frozen=True)
class LaneScoreColumns:
    """Scores of the boundaries in the image, as in public benchmarks."""

    lane_tusimple_accuracy: Annotated[
        float | None,
        _score(
            "share of rows where abs(x - x*) < 20 px / cos(a), mean over the true lanes; a is the true lane's angle to "
            "the vertical",
            RATIO,
            "",
            "lane points (TuSimple)",
            3,
            better="high",
            limit=0.85,
        ),
    ] = None
    lane_tusimple_fp: Annotated[
        float | None,
        _score(
            "(found lanes - matched true lanes) / found lanes; matched at an accuracy of 0.85 or more",
            RATIO,
            "",
            "wrong lanes (TuSimple)",
            3,
            limit=0.4,
            relevant=0.01,
        ),
    ] = None
    lane_tusimple_fn: Annotated[
        float | None,
        _score("unmatched true lanes / true lanes", RATIO, "", "missed lanes (TuSimple)", 3, limit=0.4, relevant=0.01),
    ] = None
    lane_culane_tp_50: Annotated[int | None, _culane("true positives")] = None
    lane_culane_fp_50: Annotated[int | None, _culane("false positives")] = None
    lane_culane_fn_50: Annotated[int | None, _culane("false negatives")] = None
    lane_culane_tp_30: Annotated[int | None, _culane("true positives")] = None
    lane_culane_fp_30: Annotated[int | None, _culane("false positives")] = None
    lane_culane_fn_30: Annotated[int | None, _culane("false negatives")] = None


@dataclass(frozen=True)
class ObjectErrorColumns:
    """Errors of distances, and of the filter of detections."""

    object_distance_error_m: Annotated[
        float | None,
        _score(
            "mean of abs(d - d*) over kept detections",
            "m",
            "no kept detection with both distances",
            "object distance error",
            3,
            limit=1.0,
            relevant=0.05,
        ),
    ] = None
    filter_tp: Annotated[int | None, Column("kept detections that match a true object", COUNT)] = None
    filter_fp: Annotated[int | None, Column("kept detections that match no true object", COUNT)] = None
    filter_fn: Annotated[int | None, Column("dropped detections that match a true object", COUNT)] = None
    filter_tn: Annotated[int | None, Column("dropped detections that match no true object", COUNT)] = None
    filter_precision: Annotated[
        float | None,
        _score("tp / (tp + fp)", RATIO, "nothing was kept", "filter precision", 3, better="high", relevant=0.01),
    ] = None
    filter_recall: Annotated[
        float | None,
        _score(
            "tp / (tp + fn)",
            RATIO,
            "no detection matches a true object",
            "filter recall",
            3,
            better="high",
            relevant=0.01,
        ),
    ] = None


@dataclass(frozen=True)
class TrueObjectColumns:
    """The true objects of the frame, also those without a detection."""

    true_object_labels: Annotated[tuple[str, ...], Column("classes of true objects with a distance")] = ()
    true_object_distances_m: Annotated[tuple[float, ...], Column("their distances", "m")] = ()
    true_object_laterals_m: Annotated[
        tuple[float, ...], Column("their lateral distances from the path's middle", "m")
    ] = ()


@dataclass(frozen=True)
class TrueImpactColumns:
    """The true time to impact, and the error of the estimated one."""

    true_time_to_impact_s: Annotated[
        float | None,
        Column(
            "smallest true time to impact in the path",
            "s",
            "no object in the path comes nearer, or no such truth",
        ),
    ] = None
    time_to_impact_error_s: Annotated[
        float | None,
        _score(
            "t - t*, the smallest time to impact in the path",
            "s",
            "either is unknown",
            "time to impact error",
            3,
            better="near 0",
            limit=1.0,
        ),
    ] = None


@dataclass(frozen=True)
class StereoErrorColumns:
    """Errors of stereo depth against the depth camera, where both cameras see."""

    stereo_epe_px: Annotated[
        float | None, _score("mean of abs(d - d*)", "px", "", "stereo disparity error", 2, limit=3.0)
    ] = None
    stereo_d1_ratio: Annotated[
        float | None,
        _score(
            "share with abs(d - d*) > 3 px and abs(d - d*) > 0.05 d*", RATIO, "", "stereo outliers (D1)", 4, limit=0.1
        ),
    ] = None
    stereo_abs_rel: Annotated[
        float | None, _score("mean of abs(Z - Z*) / Z*", RATIO, "", "stereo relative depth error", 4, limit=0.2)
    ] = None
    stereo_coverage: Annotated[
        float | None,
        _score(
            "share of counted pixels with a disparity",
            RATIO,
            "",
            "stereo true pixels known",
            3,
            better="high",
            limit=0.9,
        ),
    ] = None


@dataclass(frozen=True)
class OdometryErrorColumns:
    """Errors of the step since the last frame."""

    step_error_m: Annotated[
        float | None,
        _score(
            "length of the translation of E = (T*ₖ₋₁⁻¹ T*ₖ)⁻¹ S, with S the estimated step",
            "m",
            "no step, true pose or scale",
            "step error",
            4,
            limit=0.05,
            relevant=0.002,
        ),
    ] = None
    turn_error_deg: Annotated[
        float | None,
        _score(
            "angle of the rotation of E",
            "deg",
            "no step or true pose",
            "turn error",
            4,
            limit=0.2,
            relevant=0.01,
        ),
    ] = None
    true_step_m: Annotated[
        float | None,
        Column("true `step_m`", "m", "no step or true pose"),
    ] = None
    true_turn_deg: Annotated[float | None, Column("true `turn_deg`", "deg", "no step or true pose")] = None


_POSITION = "true position of the ego frame in odom"
_ORIENTATION = "true orientation, unit quaternion"


def _true_pose(what: str, unit: str = "") -> Column:
    return Column(what, unit, "no true pose")


@dataclass(frozen=True)
class TruePoseColumns:
    """The true pose odom_T_ego, so that the table alone is enough to evaluate trajectories."""

    true_x_m: Annotated[float | None, _true_pose(_POSITION, "m")] = None
    true_y_m: Annotated[float | None, _true_pose(_POSITION, "m")] = None
    true_z_m: Annotated[float | None, _true_pose(_POSITION, "m")] = None
    true_qx: Annotated[float | None, _true_pose(_ORIENTATION)] = None
    true_qy: Annotated[float | None, _true_pose(_ORIENTATION)] = None
    true_qz: Annotated[float | None, _true_pose(_ORIENTATION)] = None
    true_qw: Annotated[float | None, _true_pose(_ORIENTATION)] = None
