"""Columns of the chain's estimates, which need no truth."""

from dataclasses import dataclass
from typing import Annotated

from roadperc_stream.schemas.columns.column import COUNT, RATIO, Column

_NO_PLANE = "no plane was found"
_NOT_RUN = "the stage did not run"


def _count(meaning: str, label: str, null: str = _NOT_RUN) -> Column:
    """Return the column of a count whose absence another column also shows."""
    return Column(meaning, COUNT, null, label=label, decimals=1, compares_coverage=False)


def _shown_beside(meaning: str, unit: str, null: str, label: str, decimals: int) -> Column:
    """Return the column of a measurement whose absence another column also shows."""
    return Column(meaning, unit, null, label=label, decimals=decimals, compares_coverage=False)


@dataclass(frozen=True)
class SurfaceColumns:
    """The road's plane and the drivable pixels."""

    surface_inlier_ratio: Annotated[
        float | None,
        Column(
            "share of the considered points on the plane",
            RATIO,
            _NO_PLANE,
            label="surface inlier ratio",
            decimals=3,
            better="high",
        ),
    ] = None
    camera_height_m: Annotated[
        float | None,
        Column("height of the depth's camera above the road", "m", _NO_PLANE, label="camera height", decimals=3),
    ] = None
    camera_pitch_deg: Annotated[
        float | None,
        _shown_beside("pitch of that camera against the road, nose down positive", "deg", _NO_PLANE, "camera pitch", 3),
    ] = None
    camera_roll_deg: Annotated[
        float | None,
        _shown_beside(
            "roll of that camera against the road, right side down positive", "deg", _NO_PLANE, "camera roll", 3
        ),
    ] = None
    drivable_ratio: Annotated[
        float | None,
        Column("drivable pixels / pixels of the image", RATIO, "no mask", label="drivable share of image", decimals=3),
    ] = None
    surface_source: Annotated[
        str | None,
        Column(
            "[source of the plane](chain.md#the-road): `depth`, `stereo`, `lidar`, `lower_image`, `held`, "
            "`estimated` or `assumed`",
            null=_NO_PLANE,
        ),
    ] = None
    surface_model: Annotated[str | None, Column("`plane`, or `spline` with a height field", null=_NO_PLANE)] = None


_STATUS = Column("`measured`, `held` (predicted without a measurement) or `lost`")


def _offset(side: str) -> Column:
    meaning = "smoothed lateral offset at the ego origin (x = 0), positive to the left"
    return Column(meaning, "m", "boundary lost", label=f"{side} offset", decimals=2)


def _raw_offset(side: str) -> Column:
    meaning = "lateral offset as measured in this frame alone"
    return Column(meaning, "m", "boundary held or lost", label=f"{side} raw_offset", decimals=2)


_BOUNDARY_CLASS = Column(
    "class of the pixels beyond the boundary, such as `sidewalk`", null="boundary lost, or not known"
)
_BOTH_LOST = "both boundaries are lost"


_OFFSET_STD = Column("standard deviation of the smoothed offset, by the filter's covariance", "m", "boundary lost")


@dataclass(frozen=True)
class LaneColumns:
    """The two boundaries of the ego lane."""

    lane_left_status: Annotated[str | None, _STATUS] = None
    lane_left_offset_m: Annotated[float | None, _offset("left")] = None
    lane_left_raw_offset_m: Annotated[float | None, _raw_offset("left")] = None
    lane_left_boundary_class: Annotated[str | None, _BOUNDARY_CLASS] = None
    lane_right_status: Annotated[str | None, _STATUS] = None
    lane_right_offset_m: Annotated[float | None, _offset("right")] = None
    lane_right_raw_offset_m: Annotated[float | None, _raw_offset("right")] = None
    lane_right_boundary_class: Annotated[str | None, _BOUNDARY_CLASS] = None
    lane_width_m: Annotated[
        float | None, _shown_beside("left offset minus right offset", "m", "a boundary is lost", "lane width", 3)
    ] = None
    lane_heading_deg: Annotated[
        float | None,
        _shown_beside(
            "mean heading of the boundaries, positive to the left",
            "deg",
            _BOTH_LOST,
            "lane heading",
            3,
        ),
    ] = None
    lane_left_offset_std_m: Annotated[float | None, _OFFSET_STD] = None
    lane_right_offset_std_m: Annotated[float | None, _OFFSET_STD] = None
    lane_heading_std_deg: Annotated[
        float | None,
        Column("standard deviation of `lane_heading_deg`", "deg", _BOTH_LOST),
    ] = None
    lane_change: Annotated[
        str | None,
        Column(
            "`left` or `right` while part of the car is over the line, else `none`",
            null=_NOT_RUN,
        ),
    ] = None
    lane_changes: Annotated[
        int | None, Column("lines that the ego origin has crossed since the first frame", COUNT, _NOT_RUN)
    ] = None
    lane_proposals: Annotated[int | None, _count("lines found in the image", "lane lines proposed")] = None
    lane_merged: Annotated[int | None, _count("lines after merging", "lane lines merged")] = None


@dataclass(frozen=True)
class ObjectColumns:
    """Numbers of detections, and the nearest and most urgent ones."""

    detections: Annotated[
        int | None, Column("all detections", COUNT, _NOT_RUN, label="detections a frame", decimals=1)
    ] = None
    detections_kept: Annotated[int | None, _count("kept by the filter", "detections kept")] = None
    detections_unjudged: Annotated[
        int | None,
        _count(
            "kept without a check: no segmentation, or an unknown label",
            "detections unverified",
        ),
    ] = None
    objects_carried: Annotated[
        int | None,
        _count("objects that the detector missed, found by image patch or depth", "objects carried"),
    ] = None
    nearest_object_m: Annotated[
        float | None,
        _shown_beside("distance of the nearest kept object", "m", "no kept object has a distance", "nearest object", 2),
    ] = None
    nearest_object_class: Annotated[str | None, Column("label of that object", null="the same")] = None
    time_to_impact_s: Annotated[
        float | None,
        _shown_beside(
            "smallest time to impact in the path",
            "s",
            "none in the path comes nearer",
            "time to impact",
            2,
        ),
    ] = None
    time_to_impact_std_s: Annotated[float | None, Column("its standard deviation", "s", "the same")] = None
    path_source: Annotated[
        str | None,
        Column(
            "source of the [path](#what-is-in-the-path): `lane`, `boundary`, `odometry` or `straight`",
            null=_NOT_RUN,
        ),
    ] = None
    objects_in_path: Annotated[
        int | None,
        _count(
            "kept objects in the path",
            "objects in the path",
            "the stage did not run, or no object has a place",
        ),
    ] = None
    cut_ins: Annotated[
        int | None,
        _count(
            "kept objects that move into the path",
            "cut-ins",
            "the stage did not run, or no lane is known",
        ),
    ] = None


@dataclass(frozen=True)
class StereoColumns:
    """Depth from the stereo pair."""

    stereo_valid_ratio: Annotated[
        float | None,
        Column("pixels with a depth / pixels", RATIO, "no stereo depth", label="stereo valid pixels", decimals=3),
    ] = None
    stereo_nearest_m: Annotated[
        float | None,
        Column("2 % quantile of the depths", "m", "no pixel has a depth", label="stereo nearest", decimals=2),
    ] = None


_POSITION = "position of the ego frame in odom"
_ORIENTATION = "orientation, unit quaternion"


def _pose(what: str, unit: str = "") -> Column:
    return Column(what, unit, "as the status, or unknown scale")


@dataclass(frozen=True)
class OdometryColumns:
    """The car's motion since the last frame, and its pose since the first."""

    odometry_status: Annotated[
        str | None, Column("`first`, `tracked` or `lost`", null="the stage did not run, or has no image")
    ] = None
    odometry_inliers: Annotated[
        int | None, _count("points that agree with the motion", "odometry inliers", "as the status")
    ] = None
    step_m: Annotated[
        float | None,
        Column("length of the step since the last frame", "m", "no step, or no scale", label="step", decimals=3),
    ] = None
    step_std_m: Annotated[
        float | None,
        Column("standard deviation of `step_m`", "m", "no step, no scale, no covariance", label="step std", decimals=4),
    ] = None
    turn_deg: Annotated[
        float | None, _shown_beside("angle of the rotation since the last frame", "deg", "no step", "turn", 3)
    ] = None
    turn_std_deg: Annotated[
        float | None,
        Column("standard deviation of `turn_deg`", "deg", "no step, no covariance", label="turn std", decimals=4),
    ] = None
    odom_x_m: Annotated[float | None, _pose(_POSITION, "m")] = None
    odom_y_m: Annotated[float | None, _pose(_POSITION, "m")] = None
    odom_z_m: Annotated[float | None, _pose(_POSITION, "m")] = None
    odom_qx: Annotated[float | None, _pose(_ORIENTATION)] = None
    odom_qy: Annotated[float | None, _pose(_ORIENTATION)] = None
    odom_qz: Annotated[float | None, _pose(_ORIENTATION)] = None
    odom_qw: Annotated[float | None, _pose(_ORIENTATION)] = None
