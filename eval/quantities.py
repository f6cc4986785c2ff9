"""What a report shows of a metrics table, stored or derived, and how it writes numbers and names."""

from collections import Counter
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import polars as pl
from rich.console import Console

from roadperc_stream.schemas.columns import COUNT, TIME_COLUMNS, UNITLESS, InputColumns, columns_of, errors, estimates
from roadperc_stream.schemas.columns.column import Better


@dataclass(frozen=True)
class Quantity:
    """A numeric column and how it is shown.

    ``decimals`` is the number of digits after the point. ``better`` is the side of the good values: where it is not
    ``high``, large absolute values are bad; where it is ``near 0``, a median other than zero is a bias.
    """

    column: str
    name: str
    unit: str
    decimals: int
    better: Better = ""

    @property
    def label(self) -> str:
        """Name with unit, where there is one."""
        return self.name if self.unit in UNITLESS else f"{self.name}, {self.unit}"

    @property
    def judged(self) -> pl.Expr:
        """What frames are judged by: the absolute value of an error, the value itself of what is better high."""
        return pl.col(self.column) if self.better == "high" else pl.col(self.column).abs()


def _quantities(*groups: type) -> tuple[Quantity, ...]:
    """The columns of the groups that reports list."""
    columns = [(name, column) for group in groups for name, column in columns_of(group).items() if column.label]
    return tuple(Quantity(name, column.label, column.unit, column.decimals, column.better) for name, column in columns)


SIDES: Final = ("left", "right")
_ESTIMATES: Final = _quantities(
    estimates.SurfaceColumns,
    estimates.LaneColumns,
    estimates.ObjectColumns,
    estimates.StereoColumns,
    estimates.OdometryColumns,
)
_OFFSET_COLUMNS: Final = tuple(f"lane_{side}_{kind}offset_m" for side in SIDES for kind in ("", "raw_"))
OFFSETS: Final = tuple(q for q in _ESTIMATES if q.column in _OFFSET_COLUMNS)
SEEN: Final = tuple(q for q in _ESTIMATES if q.column not in _OFFSET_COLUMNS)
"""What the chain says, with no truth needed; the lane offsets have a table of their own."""

TRUTH: Final = _quantities(
    errors.SurfaceErrorColumns,
    errors.LaneErrorColumns,
    errors.LaneScoreColumns,
    errors.TrueImpactColumns,
    errors.ObjectErrorColumns,
    errors.StereoErrorColumns,
    errors.OdometryErrorColumns,
)
"""What the chain says against what is true."""

TOTAL: Final = Quantity("total_ms", "total", "ms", 2)
REST: Final = Quantity("rest_ms", "rest", "ms", 2)
"""The frame's time less its stages': derived, not a column of the table."""
STAGE_TIMES: Final = (
    *(Quantity(name, name.removesuffix("_ms"), "ms", 2) for name in TIME_COLUMNS if name != TOTAL.column),
    REST,
    TOTAL,
)

(SKEW,) = _quantities(InputColumns)
JITTERS: Final = tuple(
    Quantity(f"lane_{side}_{kind}second_difference_m", f"{side} jitter", "m", 4)
    for side in SIDES
    for kind in ("", "raw_")
)
"""Second differences of the offsets, from frame to frame: derived, not columns of the table."""

CATEGORIES: Final = (
    "surface_source",
    "surface_model",
    *(f"lane_{side}_{what}" for side in SIDES for what in ("status", "boundary_class")),
    "odometry_status",
)
LOST: Final = Quantity("lanes_lost", "lane boundaries lost", COUNT, 0)
"""How many of the two boundaries a frame goes without, where any: derived, not a column of the table."""
DERIVED: Final = (REST, LOST, *JITTERS)
STORED: Final = tuple(q for q in (*SEEN, *TRUTH, *STAGE_TIMES, SKEW, *OFFSETS) if q != REST)
NUMBERS: Final = (*STORED, *DERIVED)
SUSPECT: Final = (LOST, SEEN[0], TOTAL)
"""Signs of trouble that need no truth."""
RANKED: Final = (*TRUTH, *SUSPECT)
"""By these frames and logs may be the worst."""
COVERED: Final = {
    "surface": "camera_height_m",
    "drivable": "drivable_ratio",
    "left": "lane_left_offset_m",
    "right": "lane_right_offset_m",
    "objects": "detections",
    "stereo": "stereo_valid_ratio",
    "odometry": "step_m",
}
"""The column that says of each output whether a frame has it."""
COUNTED: Final = {
    "detections kept": ("filter_tp", "filter_fp", "filter_fn"),
    "lanes at IoU 0.5": ("lane_culane_tp_50", "lane_culane_fp_50", "lane_culane_fn_50"),
    "lanes at IoU 0.3": ("lane_culane_tp_30", "lane_culane_fp_30", "lane_culane_fn_30"),
}
COUNTS: Final = tuple(column for columns in COUNTED.values() for column in columns)
"""Columns whose sums over a run are the counts of its scores."""
TRACED: Final = {side: (f"lane_{side}_offset_m", f"lane_{side}_true_offset_m") for side in SIDES}
"""What is smoothed and might lag, and the truth it follows."""
_NUMBERS_COLUMNS: Final = 65
"""Characters that the widest row of numbers needs next to a run's name."""
_CUT: Final = "…"


def ranked(present: Container[str]) -> list[Quantity]:
    """What frames and logs are the worst by: the errors among columns that are present, else signs of trouble."""
    return [q for q in TRUTH if q.column in present] or [q for q in SUSPECT if q.column in present]


def rounded(value: float, quantity: Quantity) -> str:
    """A value with the quantity's digits and never a negative zero."""
    return f"{value:z.{quantity.decimals}f}"


def name_columns(console: Console) -> int:
    """Characters a run's name may have."""
    return console.width - _NUMBERS_COLUMNS


def short_names(names: Sequence[str], columns: int) -> dict[str, str]:
    """What each name is called where only so many characters fit: itself, or its two ends.

    Where two would be called the same, a number in front tells them apart.
    """
    cut = {name: _cut(name, columns) for name in names}
    shared = Counter(cut.values())
    return {
        name: short if shared[short] == 1 else f"{number} {_cut(name, columns - len(f'{number} '))}"
        for number, (name, short) in enumerate(cut.items(), 1)
    }


def legend(names: Mapping[str, str]) -> Iterator[str]:
    """A line on each name that had to be cut."""
    yield from (f"{short}: {name}" for name, short in names.items() if short != name)


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names in a line: the first of many, and how many more there are."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def _cut(name: str, columns: int) -> str:
    if len(name) <= columns:
        return name
    front = (columns - len(_CUT)) // 2
    return f"{name[:front]}{_CUT}{name[len(name) - (columns - len(_CUT) - front) :]}"


def percent(share: float) -> str:
    """A share from 0 to 1 in percent."""
    return f"{100 * share:.1f}"
