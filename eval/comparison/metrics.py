"""Which metrics two runs are judged by, each a value per frame that knows which way is better.

Errors against truth and the jitter of the lane boundaries are judged over the frames in which both runs have them;
coverage and states over all frames both runs have, as 1 or 0. What the chain says without truth to compare it with
(camera height, lane width, inliers) has no better side and is left to the comparison of fields.
"""

from dataclasses import dataclass, replace
from typing import Final

import polars as pl

from roadperc_stream.schemas.columns import FrameMetrics, columns_of

from ..quantities import JITTERS, OFFSETS, SEEN, SIDES, STAGE_TIMES, TRUTH, Quantity

_COLUMNS: Final = columns_of(FrameMetrics)


@dataclass(frozen=True)
class Metric:
    """A number per frame, float64, null where unknown.

    ``name`` is what ``--allow`` and ``--ignore`` match; ``share`` says that the values are 1 and 0; ``timed`` that it
    is a time, which depends on the machine and is judged on request only.
    """

    name: str
    value: pl.Expr
    decimals: int
    higher_is_better: bool = False
    share: bool = False
    timed: bool = False


def _of_quantity(quantity: Quantity, *, timed: bool = False) -> Metric:
    """The absolute value of an error; the value itself of what is better high."""
    column = pl.col(quantity.column)
    high = quantity.worse == "low"
    return Metric(quantity.column, column if high else column.abs(), quantity.decimals, high, timed=timed)


def _coverage(column: str) -> Metric:
    return _share(f"{column}.coverage", pl.col(column).is_not_null())


def _state(column: str, state: str) -> Metric:
    return _share(f"{column}.{state}", (pl.col(column) == state).fill_null(value=False))


def _share(name: str, holds: pl.Expr) -> Metric:
    return Metric(name, holds.cast(pl.Float64), 3, higher_is_better=True, share=True)


def _jitter(quantity: Quantity) -> Metric:
    return replace(_of_quantity(quantity), name=quantity.column.replace("second_difference", "jitter"))


ACCURACY: Final = (*map(_of_quantity, TRUTH), *map(_jitter, JITTERS))
STATES: Final = (
    _state("surface_source", "depth"),
    *(_state(f"lane_{side}_status", "measured") for side in SIDES),
    _state("odometry_status", "tracked"),
)
COVERAGE: Final = (
    _coverage("surface_source"),
    *(_coverage(q.column) for q in (*SEEN, *OFFSETS, *TRUTH) if _COLUMNS[q.column].compares_coverage),
)
TIMES: Final = tuple(_of_quantity(quantity, timed=True) for quantity in STAGE_TIMES)
METRICS: Final = (*ACCURACY, *STATES, *COVERAGE, *TIMES)

FRAMES: Final = _share("frames.coverage", pl.lit(value=True))
"""The reference's frames that the candidate has."""
