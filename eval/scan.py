"""Metrics tables as lazy polars frames, and the expressions that summarise their columns.

A table starts a new segment where its stamps step back: at another recording, or in a bag played in a loop. No
difference, gap or motion is measured across segments. Time continues from one segment to the next without a gap.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.system.time import NS_PER_S

from .report_columns import (
    COUNTS,
    LOST,
    MEASURED,
    REST,
    SIDES,
    SPEED,
    STAGE_TIMES,
    STORED,
    TEXTS,
    TOTAL,
    TRACED,
    UNMEASURED,
)
from .runs import Run, written_columns

SEGMENT: Final = "segment"
_STAMP_NS: Final = pl.col("stamp_ns")
_LANE_CHANGES: Final = "lane_changes"
_INLIERS: Final = "odometry_inliers"
_STATUS: Final = "odometry_status"
_TRUE_OFFSETS: Final = tuple(truth for _, truth in TRACED.values())
NUMBER_COLUMNS: Final = tuple(dict.fromkeys((*(q.column for q in STORED), *COUNTS, *_TRUE_OFFSETS, _LANE_CHANGES)))
"""The numeric columns of a report."""


def scan(run: Run) -> pl.LazyFrame:
    """The columns of a report from one run, as in ``scanned``."""
    return scanned(rows_of(run))


def scanned(rows: pl.LazyFrame) -> pl.LazyFrame:
    """The columns of a report, a row per frame; then the derived columns."""
    stored = rows.select(stored_columns()).with_columns(finite(NUMBER_COLUMNS))
    return stored.with_columns(since_start_s(), *row_columns(), *neighbour_columns())


def rows_of(run: Run) -> pl.LazyFrame:
    """All columns of a run's tables, one row per frame; frames repeated by a continued replay appear once."""
    return pl.concat([_rows_of_table(table) for table in run.tables])


def _rows_of_table(table: Run) -> pl.LazyFrame:
    rows = pl.scan_parquet(table.path, glob=False)
    if table.within is not None:
        log_id, config = table.within
        rows = rows.filter(pl.col("log_id") == log_id, pl.col("config") == config)
    return rows if table.end_frame is None else rows.filter(pl.col("frame") < table.end_frame)


def objects_of(name: str, table: Run, path: Path) -> pl.LazyFrame:
    """The rows of the table of objects at ``path``, which belongs to a metrics table; ``log`` is ``name``."""
    rows = pl.scan_parquet(path, glob=False).with_columns(pl.lit(name).alias("log"))
    return rows if table.end_frame is None else rows.filter(pl.col("frame") < table.end_frame)


def stored_columns() -> list[pl.Expr]:
    """The columns of a report."""
    return [
        pl.col("log_id").cast(pl.String),
        pl.col("frame", "stamp_ns", SEGMENT).cast(pl.Int64),
        pl.col("missing").cast(pl.List(pl.String)),
        pl.col("reasons").cast(written_columns()["reasons"]),
        pl.col([name for name in NUMBER_COLUMNS if name != _INLIERS]).cast(pl.Float64),
        pl.col(TEXTS).cast(pl.String),
        _inliers(),
    ]


def _inliers() -> pl.Expr:
    """The inliers of frames with a motion: the first frame and lost ones have none."""
    status = pl.col(_STATUS).cast(pl.String)
    return pl.when(status.is_null() | (status == "tracked")).then(pl.col(_INLIERS).cast(pl.Float64)).alias(_INLIERS)


def finite(names: Iterable[str]) -> list[pl.Expr]:
    """Numeric columns with null in place of values that are not finite."""
    return [pl.when(pl.col(name).is_finite()).then(pl.col(name)).alias(name) for name in names]


def before(values: pl.Expr, rows: int) -> pl.Expr:
    """The values ``rows`` rows earlier (negative: later) in the same segment; else null.

    The rows of a segment are contiguous, so a shift replaces a window expression, which is many times slower.
    """
    return pl.when(pl.col(SEGMENT).shift(rows) == pl.col(SEGMENT)).then(values.shift(rows))


def difference(values: pl.Expr) -> pl.Expr:
    """The difference from the previous row of the same segment."""
    return values - before(values, 1)


def since_start_s() -> pl.Expr:
    """Seconds from the table's first frame; a segment starts at the time at which the previous one ended."""
    earlier_ns = _spans_ns().fill_null(0).cum_sum() - _span_ns()
    return ((_STAMP_NS - _STAMP_NS.min().over(SEGMENT) + earlier_ns) / NS_PER_S).alias("since_start_s")


def _spans_ns() -> pl.Expr:
    """The span of each segment in its first row; null in the other rows."""
    return pl.when(pl.col(SEGMENT).is_first_distinct()).then(_span_ns())


def _span_ns() -> pl.Expr:
    return (_STAMP_NS.max() - _STAMP_NS.min()).over(SEGMENT)


def row_columns() -> list[pl.Expr]:
    """Columns derived within a row: time outside the stages, lost boundaries (null if 0), measured outputs."""
    stages = [quantity.column for quantity in STAGE_TIMES if quantity not in {TOTAL, REST}]
    lost = pl.sum_horizontal((pl.col(f"lane_{side}_status") == "lost").cast(pl.Float64) for side in SIDES)
    return [
        (pl.col(TOTAL.column) - pl.sum_horizontal(stages)).clip(0.0).alias(REST.column),
        pl.when(lost > 0).then(lost).alias(LOST.column),
        *(
            pl.when(~pl.col(status).fill_null("").is_in(UNMEASURED)).then(pl.col(column)).alias(name)
            for name, (column, status) in MEASURED.items()
        ),
    ]


def neighbour_columns() -> list[pl.Expr]:
    """Columns derived from neighbouring rows: the speed, and the second differences of the lane offsets."""
    speed = pl.col("step_m") * NS_PER_S / difference(_STAMP_NS)
    return [speed.alias(SPEED.column), *(column for side in SIDES for column in _second_differences(side))]


def _second_differences(side: str) -> list[pl.Expr]:
    """Second differences of a side's smoothed and raw offset, in metres, over the same frames of one segment.

    Frames without a measurement have no raw offset, so both must be known. At a lane change the offset jumps to another
    boundary; differences across it are left out.
    """
    names = [f"lane_{side}_offset_m", f"lane_{side}_raw_offset_m"]
    differences = [difference(difference(pl.col(name))) for name in names]
    same_lane = (pl.col(_LANE_CHANGES) == pl.col(_LANE_CHANGES).shift(2)).fill_null(value=True)
    known = differences[0].is_not_null() & differences[1].is_not_null() & same_lane
    return [
        pl.when(known).then(change).alias(name.replace("offset", "second_difference"))
        for name, change in zip(names, differences, strict=True)
    ]
