"""What a report shows of a metrics table, in which order, under which name, unit and rounding."""

from dataclasses import dataclass
from typing import Final, Literal

from roadperc_stream.schemas.columns import TIME_COLUMNS

COUNT: Final = "count"
RATIO: Final = "ratio"


@dataclass(frozen=True)
class Quantity:
    """A numeric column and how it is shown.

    ``decimals`` are digits behind the point; ``worse`` is the side on which bad values lie; ``signed`` says that the
    sign means something, so that a median other than zero is a bias.
    """

    column: str
    name: str
    unit: str
    decimals: int
    worse: Literal["high", "low"] = "high"
    signed: bool = False

    @property
    def label(self) -> str:
        """Name with unit, where there is one."""
        return self.name if self.unit in {COUNT, RATIO} else f"{self.name}, {self.unit}"


SEEN: Final = (
    Quantity("surface_inlier_ratio", "surface inlier ratio", RATIO, 3, worse="low"),
    Quantity("camera_height_m", "camera height", "m", 3),
    Quantity("camera_pitch_deg", "camera pitch", "deg", 3),
    Quantity("camera_roll_deg", "camera roll", "deg", 3),
    Quantity("drivable_ratio", "drivable share of image", RATIO, 3),
    Quantity("lane_width_m", "lane width", "m", 3),
    Quantity("lane_heading_deg", "lane heading", "deg", 3),
    Quantity("lane_proposals", "lane lines proposed", COUNT, 1),
    Quantity("lane_merged", "lane lines merged", COUNT, 1),
    Quantity("detections", "detections a frame", COUNT, 1),
    Quantity("detections_kept", "detections kept", COUNT, 1),
    Quantity("detections_unjudged", "detections not judged", COUNT, 1),
    Quantity("objects_carried", "objects carried", COUNT, 1),
    Quantity("nearest_object_m", "nearest object", "m", 2),
    Quantity("time_to_impact_s", "time to impact", "s", 2),
    Quantity("stereo_valid_ratio", "stereo valid pixels", RATIO, 3),
    Quantity("stereo_nearest_m", "stereo nearest", "m", 2),
    Quantity("odometry_inliers", "odometry inliers", COUNT, 1),
    Quantity("step_m", "step", "m", 3),
    Quantity("turn_deg", "turn", "deg", 3),
)
"""What the chain says, with no truth needed."""

TRUTH: Final = (
    Quantity("surface_angle_error_deg", "surface angle", "deg", 4),
    Quantity("camera_height_error_m", "camera height", "m", 4, signed=True),
    Quantity("surface_height_error_m", "road height 5-40 m", "m", 4),
    Quantity("drivable_iou", "drivable IoU", RATIO, 3, worse="low"),
    Quantity("lane_left_error_m", "lane left at 10 m", "m", 3, signed=True),
    Quantity("lane_right_error_m", "lane right at 10 m", "m", 3, signed=True),
    Quantity("lane_tusimple_accuracy", "lane points (TuSimple)", RATIO, 3, worse="low"),
    Quantity("lane_tusimple_fp", "wrong lanes (TuSimple)", RATIO, 3),
    Quantity("lane_tusimple_fn", "missed lanes (TuSimple)", RATIO, 3),
    Quantity("filter_precision", "kept that are true", RATIO, 3, worse="low"),
    Quantity("filter_recall", "true that are kept", RATIO, 3, worse="low"),
    Quantity("object_distance_error_m", "objects' mean distance", "m", 3),
    Quantity("stereo_epe_px", "stereo disparity", "px", 2),
    Quantity("stereo_d1_ratio", "stereo outliers (D1)", RATIO, 4),
    Quantity("stereo_abs_rel", "stereo relative depth", RATIO, 4),
    Quantity("stereo_coverage", "stereo true pixels known", RATIO, 3, worse="low"),
    Quantity("step_error_m", "step", "m", 4, signed=True),
    Quantity("turn_error_deg", "turn", "deg", 4, signed=True),
)
"""What the chain says against what is true."""

TOTAL: Final = Quantity("total_ms", "total", "ms", 2)
REST: Final = Quantity("rest_ms", "copy, metrics", "ms", 2)
"""The frame's time less its stages': derived, not a column of the table."""
STAGES: Final = (
    *(Quantity(name, name.removesuffix("_ms"), "ms", 2) for name in TIME_COLUMNS if name != TOTAL.column),
    REST,
    TOTAL,
)

SKEW: Final = Quantity("sync_skew_ms", "sync skew", "ms", 1)
SIDES: Final = ("left", "right")
OFFSETS: Final = tuple(
    Quantity(f"lane_{side}_{kind}offset_m", f"{side} {kind}offset", "m", 2) for side in SIDES for kind in ("", "raw_")
)
JITTERS: Final = tuple(
    Quantity(f"lane_{side}_{kind}second_difference_m", f"{side} jitter", "m", 4)
    for side in SIDES
    for kind in ("", "raw_")
)
"""Second differences of the offsets, from frame to frame: derived, not columns of the table."""

CATEGORIES: Final = (
    "surface_source",
    *(f"lane_{side}_{what}" for side in SIDES for what in ("status", "boundary_class")),
    "odometry_status",
)
LOST: Final = Quantity("lanes_lost", "lane boundaries lost", COUNT, 0)
"""How many of the two boundaries a frame goes without, where any: derived, not a column of the table."""
DERIVED: Final = (REST, LOST, *JITTERS)
STORED: Final = tuple(q for q in (*SEEN, *TRUTH, *STAGES, SKEW, *OFFSETS) if q != REST)
NUMBERS: Final = (*STORED, *DERIVED)
SUSPECT: Final = (LOST, SEEN[0], TOTAL)
"""Signs of trouble that need no truth."""
