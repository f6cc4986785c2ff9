"""The segments of a table: where stamps begin anew (another recording, a bag played in a loop), nothing goes on.

No difference, gap, step or motion is measured from one segment to the next, and time runs through the segments one
after the other, without the time between them.
"""

from collections.abc import Container
from typing import Final

import polars as pl

SEGMENT: Final = "segment"
_STAMP_NS: Final = pl.col("stamp_ns")


def segment(columns: Container[str]) -> pl.Expr:
    """The segment of each row; tables of older versions do not have the column: they are one segment, 0.

    Args:
        columns: the table's.
    """
    if SEGMENT not in columns:
        return pl.lit(0, pl.Int64).alias(SEGMENT)
    return pl.col(SEGMENT).cast(pl.Int64).fill_null(0)


def within(values: pl.Expr) -> pl.Expr:
    """An aggregate over each segment."""
    return values.over(SEGMENT)


def before(values: pl.Expr, rows: int) -> pl.Expr:
    """The values so many rows before, or behind where ``rows`` is negative, within the segment; else null.

    The rows of a segment follow one another, so that no window is needed: these take many times as long.
    """
    return pl.when(pl.col(SEGMENT).shift(rows) == pl.col(SEGMENT)).then(values.shift(rows))


def difference(values: pl.Expr) -> pl.Expr:
    """What is added from the row before, of the same segment."""
    return values - before(values, 1)


def elapsed_ns() -> pl.Expr:
    """Nanoseconds from the table's first frame; a segment begins at the instant at which the one before ended."""
    earlier_ns = _spans_ns().fill_null(0).cum_sum() - _span_ns()
    return _STAMP_NS - within(_STAMP_NS.min()) + earlier_ns


def whole_span_ns() -> pl.Expr:
    """Nanoseconds from first to last frame of each segment, summed."""
    return _spans_ns().sum()


def longest_gap_ns() -> pl.Expr:
    """The longest time between two frames of a segment; null where no segment has two."""
    return difference(_STAMP_NS).max()


def _spans_ns() -> pl.Expr:
    """The span of each segment in its first row, null in the others."""
    return pl.when(pl.col(SEGMENT).is_first_distinct()).then(_span_ns())


def _span_ns() -> pl.Expr:
    return within(_STAMP_NS.max() - _STAMP_NS.min())
