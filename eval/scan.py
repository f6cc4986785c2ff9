"""Metrics tables as lazy polars frames, and the expressions that boil their columns down.

In the segments of a table (stamps begin anew there: another recording, a bag played in a loop) nothing goes on: no
difference, gap, step or motion is measured from one to the next, and time runs through the segments one after the
other, without the time between them.
"""

from collections.abc import Container, Iterable
from typing import Final

import polars as pl

from roadperc_stream.schemas.columns import RATIO
from roadperc_stream.system.time import NS_PER_S

from .quantities import CATEGORIES, COUNTS, LOST, REST, SIDES, STAGE_TIMES, STORED, TOTAL, TRACED, Quantity
from .runs import Run

SEGMENT: Final = "segment"
_STAMP_NS: Final = pl.col("stamp_ns")
_LANE_CHANGES: Final = "lane_changes"
NUMBER_COLUMNS: Final = tuple(
    dict.fromkeys(
        (*(quantity.column for quantity in STORED), *COUNTS, *(truth for _, truth in TRACED.values()), _LANE_CHANGES)
    )
)
"""The numeric columns a report needs."""


def scan(run: Run) -> pl.LazyFrame:
    """The columns a report needs of a run, as ``scanned`` gives them."""
    return scanned(rows_of(run), run.columns)


def scanned(rows: pl.LazyFrame, columns: Container[str]) -> pl.LazyFrame:
    """The columns a report needs, a row per frame; those that are not among ``columns`` are null.

    Derived columns come behind: ``since_start_s`` and those of ``derived_columns``.
    """
    stored = rows.select(stored_columns(columns)).with_columns(finite(NUMBER_COLUMNS))
    return stored.with_columns(since_start_s(), *derived_columns())


def rows_of(run: Run) -> pl.LazyFrame:
    """All columns of a run's tables, a row per frame; of frames that a later part gives again that part's alone."""
    return pl.concat([_rows_of_table(table) for table in run.tables])


def _rows_of_table(table: Run) -> pl.LazyFrame:
    rows = pl.scan_parquet(table.path, glob=False)
    if table.within is not None:
        log_id, config = table.within
        rows = rows.filter(pl.col("log_id") == log_id, pl.col("config") == config)
    return rows if table.end_frame is None else rows.filter(pl.col("frame") < table.end_frame)


def stored_columns(columns: Container[str]) -> list[pl.Expr]:
    """The columns a report needs; those that are not among ``columns`` are null."""
    return [
        pl.col("log_id").cast(pl.String),
        pl.col("frame", "stamp_ns").cast(pl.Int64),
        segment(columns),
        pl.col("missing", "reasons").cast(pl.List(pl.String)),
        *(typed(columns, name, pl.Float64()) for name in NUMBER_COLUMNS),
        *(typed(columns, name, pl.String()) for name in CATEGORIES),
    ]


def typed(columns: Container[str], name: str, kind: pl.DataType) -> pl.Expr:
    """A column of a type; null where it is not among ``columns``."""
    return pl.col(name).cast(kind) if name in columns else pl.lit(None, kind).alias(name)


def finite(names: Iterable[str]) -> list[pl.Expr]:
    """Numeric columns in which a value that is not finite counts as missing."""
    return [pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in names]


def segment(columns: Container[str]) -> pl.Expr:
    """The segment of each row; tables of older versions do not have the column: they are one segment, 0."""
    if SEGMENT not in columns:
        return pl.lit(0, pl.Int64).alias(SEGMENT)
    return pl.col(SEGMENT).cast(pl.Int64).fill_null(0)


def before(values: pl.Expr, rows: int) -> pl.Expr:
    """The values so many rows before, or behind where ``rows`` is negative, within the segment; else null.

    The rows of a segment follow one another, so that no window is needed: these take many times as long.
    """
    return pl.when(pl.col(SEGMENT).shift(rows) == pl.col(SEGMENT)).then(values.shift(rows))


def difference(values: pl.Expr) -> pl.Expr:
    """What is added from the row before, of the same segment."""
    return values - before(values, 1)


def since_start_s() -> pl.Expr:
    """Seconds from the table's first frame; a segment begins at the instant at which the one before ended."""
    earlier_ns = _spans_ns().fill_null(0).cum_sum() - _span_ns()
    return ((_STAMP_NS - _STAMP_NS.min().over(SEGMENT) + earlier_ns) / NS_PER_S).alias("since_start_s")


def _spans_ns() -> pl.Expr:
    """The span of each segment in its first row, null in the others."""
    return pl.when(pl.col(SEGMENT).is_first_distinct()).then(_span_ns())


def _span_ns() -> pl.Expr:
    return (_STAMP_NS.max() - _STAMP_NS.min()).over(SEGMENT)


def derived_columns() -> list[pl.Expr]:
    """The frame's time outside the stages, how many lane boundaries are lost, second differences of lane offsets.

    The lost are null where none is, or lanes were not looked for.
    """
    stages = [quantity.column for quantity in STAGE_TIMES if quantity not in {TOTAL, REST}]
    lost = pl.sum_horizontal((pl.col(f"lane_{side}_status") == "lost").cast(pl.Float64) for side in SIDES)
    return [
        (pl.col(TOTAL.column) - pl.sum_horizontal(stages)).alias(REST.column),
        pl.when(lost > 0).then(lost).alias(LOST.column),
        *(column for side in SIDES for column in _second_differences(side)),
    ]


def _second_differences(side: str) -> list[pl.Expr]:
    """Second differences of a side's smoothed and raw offset, metres, over the frames where both are known.

    Frames without a measurement have no raw offset: the two compare only on the same frames, of the same segment. Where
    a line is crossed the offset jumps to that of another boundary: what spans it is left out.
    """
    names = [f"lane_{side}_offset_m", f"lane_{side}_raw_offset_m"]
    differences = [difference(difference(pl.col(name))) for name in names]
    same_lane = (pl.col(_LANE_CHANGES) == pl.col(_LANE_CHANGES).shift(2)).fill_null(value=True)
    known = differences[0].is_not_null() & differences[1].is_not_null() & same_lane
    return [
        pl.when(known).then(change).alias(name.replace("offset", "second_difference"))
        for name, change in zip(names, differences, strict=True)
    ]


def extent() -> list[pl.Expr]:
    """Which logs, how long and how evenly; the longest gap is null where no segment has two frames."""
    return [
        pl.col("log_id").unique(maintain_order=True).implode().alias("log_ids"),
        pl.col(SEGMENT).n_unique().alias("segments"),
        (_spans_ns().sum() / NS_PER_S).alias("span_s"),
        (difference(_STAMP_NS).max() / NS_PER_S).alias("longest_gap_s"),
    ]


def worst_frames(quantity: Quantity, number: int) -> pl.Expr:
    """The worst frames by a quantity, the worst first and of equals the earliest: a list of structs.

    A frame that could not be better is none of the worst, even where no other is worse.
    """
    value = pl.col(quantity.column)
    high = quantity.better == "high"
    badness = -quantity.judged if high else quantity.judged
    flawed = badness > (-1 if high and quantity.unit == RATIO else 0)
    row = pl.struct("frame", SEGMENT, "since_start_s", "stamp_ns", value=value).filter(flawed)
    order = [badness.filter(flawed), pl.col(SEGMENT).filter(flawed), pl.col("stamp_ns").filter(flawed)]
    return row.sort_by(order, descending=[True, False, False]).head(number).implode().alias(f"worst {quantity.column}")
