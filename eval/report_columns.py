"""The numeric columns in reports, stored or derived, and the format of numbers and names."""

from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from rich.console import Console

from roadperc_stream.schemas.columns import (
    COUNT,
    TIME_COLUMNS,
    UNITLESS,
    InputColumns,
    columns_of,
    errors,
    estimates,
    hindsight,
)
from roadperc_stream.schemas.columns.column import Better


@dataclass(frozen=True)
class Quantity:
    """A numeric column of a report: its name, unit, number of decimals, and the side of the good values.

    Large absolute values are bad unless ``better`` is ``high``. If it is ``near 0``, the median is a bias. ``relevant``
    and ``limit`` are those of the column, and ``stage`` is the stage whose result it describes.
    """

    column: str
    name: str
    unit: str
    decimals: int
    better: Better = ""
    relevant: float = 0.0
    limit: float | None = None
    stage: str = ""

    @property
    def label(self) -> str:
        """Name with unit, if it has one."""
        return self.name if self.unit in UNITLESS else f"{self.name}, {self.unit}"


def _quantities(**groups: type) -> tuple[Quantity, ...]:
    """The columns with a label for reports, from the groups of columns of each stage."""
    return tuple(
        Quantity(name, at.label, at.unit, at.decimals, at.better, at.relevant, at.limit, stage.partition("_")[0])
        for stage, group in groups.items()
        for name, at in columns_of(group).items()
        if at.label
    )


SIDES: Final = ("left", "right")
_ESTIMATES: Final = _quantities(
    surface=estimates.SurfaceColumns,
    lanes=estimates.LaneColumns,
    objects=estimates.ObjectColumns,
    stereo=estimates.StereoColumns,
    odometry=estimates.OdometryColumns,
)
_OFFSET_COLUMNS: Final = tuple(f"lane_{side}_{kind}offset_m" for side in SIDES for kind in ("", "raw_"))
OFFSETS: Final = tuple(q for q in _ESTIMATES if q.column in _OFFSET_COLUMNS)
SEEN: Final = tuple(q for q in _ESTIMATES if q.column not in _OFFSET_COLUMNS)
"""Outputs of the chain that need no truth; the lane offsets have a separate table."""

TRUTH: Final = _quantities(
    surface=errors.SurfaceErrorColumns,
    lanes=errors.LaneErrorColumns,
    lanes_scored=errors.LaneScoreColumns,
    objects_impact=errors.TrueImpactColumns,
    objects=errors.ObjectErrorColumns,
    stereo=errors.StereoErrorColumns,
    odometry=errors.OdometryErrorColumns,
)
"""Errors against truth."""

HINDSIGHT: Final = _quantities(
    surface=hindsight.SurfaceHindsightColumns,
    lanes=hindsight.LaneHindsightColumns,
    objects=hindsight.ObjectHindsightColumns,
    odometry=hindsight.OdometryHindsightColumns,
)
"""Errors by hindsight, which need no truth."""
TRUTH_OF: Final = {q.column: q.column.replace("_hindsight_", "_error_") for q in HINDSIGHT}
"""For each column by hindsight the error against truth."""
AT_PLACE: Final = tuple(q.column for q in HINDSIGHT if q.stage in ("surface", "lanes"))
"""Errors of the place 10 m ahead, which a later frame finds."""
ERRORS: Final = (*TRUTH, *HINDSIGHT)

TOTAL: Final = Quantity("total_ms", "total", "ms", 2)
REST: Final = Quantity("rest_ms", "rest", "ms", 2)
"""Time of a frame outside its stages; derived."""
STAGE_TIMES: Final = (
    *(Quantity(name, name.removesuffix("_ms"), "ms", 2) for name in TIME_COLUMNS if name != TOTAL.column),
    REST,
    TOTAL,
)

(SKEW,) = _quantities(inputs=InputColumns)
JITTERS: Final = tuple(
    Quantity(
        f"lane_{side}_{kind}second_difference_m",
        f"lane {side} {'raw ' * bool(kind)}jitter",
        "m",
        4,
        relevant=relevant,
        stage="lanes",
    )
    for side in SIDES
    for kind, relevant in (("", 0.001), ("raw_", 0.01))
)
"""Second differences of the offsets from frame to frame; derived."""

CATEGORIES: Final = (
    "surface_source",
    "surface_model",
    *(f"lane_{side}_{what}" for side in SIDES for what in ("status", "boundary_class")),
    "odometry_status",
)
STATES: Final = ("surface_source", "lane_left_status", "lane_right_status", "odometry_status")
"""Whether a frame measured an output."""
CONFUSED: Final = {
    f"lane {side} classes": (f"lane_{side}_true_boundary_class", f"lane_{side}_boundary_class") for side in SIDES
}
"""Pairs of text columns, truth and estimate, whose combinations are counted."""
TEXTS: Final = (*CATEGORIES, *(truth for truth, _ in CONFUSED.values()))
LOST: Final = Quantity("lanes_lost", "lane boundaries lost", COUNT, 0)
"""Number of lost boundaries of a frame, null if 0; derived."""
SPEED: Final = Quantity("speed_mps", "speed", "m/s", 2, stage="odometry")
"""Length of a step over its time; derived."""
UNMEASURED: Final = ("held", "estimated", "assumed", "lost")
"""Statuses of outputs that a frame did not measure."""
MEASURED: Final = {
    "surface measured": ("camera_height_m", "surface_source"),
    **{f"{side} measured": (f"lane_{side}_offset_m", f"lane_{side}_status") for side in SIDES},
}
"""The derived columns that have the values of a column only in frames that measured it, by its status column."""
DERIVED: Final = (REST, LOST, SPEED, *JITTERS, *(Quantity(name, name, "m", 3) for name in MEASURED))
STORED: Final = tuple(q for q in (*SEEN, *ERRORS, *STAGE_TIMES, SKEW, *OFFSETS) if q != REST)
NUMBERS: Final = (*STORED, *DERIVED)
SUSPECT: Final = (LOST, SEEN[0], TOTAL)
"""Quantities without truth that indicate problems."""
_BETTER: Final[Mapping[str, Better]] = {
    "detections_kept": "high",
    "stereo_valid_ratio": "high",
    "odometry_inliers": "high",
    "lane_left_second_difference_m": "low",
    "lane_right_second_difference_m": "low",
}
QUALITY: Final = tuple(replace(q, better=_BETTER[q.column]) for q in (*SEEN, *JITTERS) if q.column in _BETTER)
"""Quantities that describe a stage without truth."""
RANKED: Final = {quantity.column: quantity for quantity in (*ERRORS, *SUSPECT, *QUALITY)}
"""Quantities for rankings of frames and logs, by column."""
COVERED: Final = {
    "surface": "surface measured",
    "drivable": "drivable_ratio",
    "left": "left measured",
    "right": "right measured",
    "objects": "detections",
    "stereo": "stereo_valid_ratio",
    "odometry": "turn_deg",
}
"""For each output, a column that has a value in the frames in which it was measured."""
COUNTED: Final = {
    "detections kept": ("filter_tp", "filter_fp", "filter_fn"),
    "lanes at IoU 0.5": ("lane_culane_tp_50", "lane_culane_fp_50", "lane_culane_fn_50"),
    "lanes at IoU 0.3": ("lane_culane_tp_30", "lane_culane_fp_30", "lane_culane_fn_30"),
}
COUNTS: Final = tuple(column for columns in COUNTED.values() for column in columns)
"""Columns whose sums are the counts of the scores."""
TRACED: Final = {side: (f"lane_{side}_offset_m", f"lane_{side}_true_offset_m") for side in SIDES}
"""Smoothed columns that may lag, and their truth."""
_NUMBERS_COLUMNS: Final = 65
"""Width of the widest row of numbers beside a run's name."""
_CUT: Final = "…"


def ranked(present: Container[str]) -> list[Quantity]:
    """The present quantities to rank by: errors, by hindsight only without their truth, else the suspect quantities."""
    return judged_errors(present) or [q for q in SUSPECT if q.column in present]


def judged_errors(present: Container[str]) -> list[Quantity]:
    """The present errors that judge: against truth, and by hindsight where that truth is missing."""
    return [q for q in ERRORS if q.column in present and TRUTH_OF.get(q.column) not in present]


def rounded(value: float, quantity: Quantity) -> str:
    """A value with the quantity's decimals, without negative zero."""
    return f"{value:z.{quantity.decimals}f}"


def with_unit(value: float, quantity: Quantity) -> str:
    """A value with its unit."""
    return f"{rounded(value, quantity)}{'' if quantity.unit in UNITLESS else f' {quantity.unit}'}"


def name_columns(console: Console) -> int:
    """Width for a run's name."""
    return console.width - _NUMBERS_COLUMNS


def short_names(names: Sequence[str], columns: int) -> dict[str, str]:
    """A name of at most ``columns`` characters for each name: itself, or both of its ends; numbered if not unique."""
    cut = {name: _cut(name, columns) for name in names}
    shared = Counter(cut.values())
    return {
        name: short if shared[short] == 1 else f"{number} {_cut(name, columns - len(f'{number} '))}"
        for number, (name, short) in enumerate(cut.items(), 1)
    }


def legend(names: Mapping[str, str]) -> Iterator[str]:
    """A line for each shortened name."""
    yield from (f"{short}: {name}" for name, short in names.items() if short != name)


def _cut(name: str, columns: int) -> str:
    if len(name) <= columns:
        return name
    front = (columns - len(_CUT)) // 2
    return f"{name[:front]}{_CUT}{name[len(name) - (columns - len(_CUT) - front) :]}"


def percent(share: float) -> str:
    """A ratio from 0 to 1 in percent."""
    return f"{100 * share:.1f}"
