"""Metrics tables as lazy polars frames, and the expressions that boil their columns down."""

from typing import Final

import polars as pl

from roadperc_stream.errors import TableError

from .quantities import CATEGORIES, LOST, REST, SIDES, STAGES, STORED, TOTAL, Quantity
from .runs import Run

_NANOSECONDS: Final = 1e9
_QUANTILES: Final = {"p5": 0.05, "median": 0.5, "p95": 0.95, "p99": 0.99}


def scan(run: Run) -> pl.LazyFrame:
    """The columns a report needs, a row per frame; what the table lacks is null.

    Derived columns come behind: ``since_start_s`` counted from the table's first frame, the frame's time outside the
    stages, how many lane boundaries are lost, and the second differences of the lane offsets.
    """
    stored = pl.scan_parquet(run.path, glob=False).select(
        pl.col("log_id").cast(pl.String),
        pl.col("frame", "stamp_ns").cast(pl.Int64),
        pl.col("missing", "reasons").cast(pl.List(pl.String)),
        *(_number(run, quantity.column) for quantity in STORED),
        *(_text(run, name) for name in CATEGORIES),
    )
    stages = [quantity.column for quantity in STAGES if quantity not in {TOTAL, REST}]
    return stored.with_columns(
        ((pl.col("stamp_ns") - pl.col("stamp_ns").min()) / _NANOSECONDS).alias("since_start_s"),
        (pl.col(TOTAL.column) - pl.sum_horizontal(stages)).alias(REST.column),
        _lanes_lost().alias(LOST.column),
        *(column for side in SIDES for column in _second_differences(side)),
    )


def collect(frame: pl.LazyFrame, source: str) -> pl.DataFrame:
    """The rows of a query on one table.

    In memory: of a table of 10 000 rows that takes 25 ms, where the streaming engine takes 300.

    Raises:
        TableError: the data of ``source`` cannot be read.
    """
    try:
        return frame.collect(engine="in-memory")
    except (pl.exceptions.PolarsError, OSError) as error:
        cause = (str(error).splitlines() or [type(error).__name__])[0]
        raise TableError(f"{source}: its data cannot be read: {cause}") from error


def extent() -> list[pl.Expr]:
    """Which logs, how long, how evenly and how completely."""
    stamp_ns = pl.col("stamp_ns")
    return [
        pl.col("log_id").unique().sort().implode().alias("log_ids"),
        ((stamp_ns.max() - stamp_ns.min()) / _NANOSECONDS).alias("span_s"),
        (stamp_ns.diff().max() / _NANOSECONDS).alias("longest_gap_s"),
        (pl.col("missing").list.len() > 0).sum().alias("incomplete"),
    ]


def statistics(column: str) -> pl.Expr:
    """A column's statistics as a struct named like it: the fields of ``Statistics``, null where it has no values."""
    value = pl.col(column)
    fields = {
        "values": value.count(),
        "total": value.sum(),
        "std": value.std(ddof=0),
        "least": value.min(),
        **{name: value.quantile(share, "linear") for name, share in _QUANTILES.items()},
        "abs_median": value.abs().median(),
        "abs_p95": value.abs().quantile(0.95, "linear"),
        "abs_most": value.abs().max(),
    }
    return pl.struct(expression.alias(name) for name, expression in fields.items()).alias(column)


def counts(name: str, *, of_lists: bool = False) -> pl.Expr:
    """How often each text occurs: a list of structs of ``text`` and ``count``, by text."""
    column = pl.col(name)
    texts = (column.explode() if of_lists else column).drop_nulls()
    counted = texts.value_counts(sort=True)
    return counted.struct.rename_fields(["text", "count"]).implode().alias(name)


def worst_frames(quantity: Quantity, number: int) -> pl.Expr:
    """The worst frames by a quantity, the worst first and of equals the earliest: a list of structs."""
    value = pl.col(quantity.column)
    badness = value.abs() if quantity.worse == "high" else -value
    row = pl.struct("frame", "since_start_s", "stamp_ns", value=value).filter(value.is_not_null())
    order = [badness.drop_nulls(), pl.col("stamp_ns").filter(value.is_not_null())]
    return row.sort_by(order, descending=[True, False]).head(number).implode().alias(f"worst {quantity.column}")


def _number(run: Run, name: str) -> pl.Expr:
    """A numeric column; a value that is not finite is no value."""
    if name not in run.columns:
        return pl.lit(None, pl.Float64).alias(name)
    value = pl.col(name).cast(pl.Float64)
    return pl.when(value.is_finite()).then(value).alias(name)


def _text(run: Run, name: str) -> pl.Expr:
    return pl.col(name).cast(pl.String) if name in run.columns else pl.lit(None, pl.String).alias(name)


def _lanes_lost() -> pl.Expr:
    """How many ego boundaries a frame goes without; null where none is lost or lanes were not looked for."""
    lost = pl.sum_horizontal((pl.col(f"lane_{side}_status") == "lost").cast(pl.Float64) for side in SIDES)
    return pl.when(lost > 0).then(lost)


def _second_differences(side: str) -> list[pl.Expr]:
    """Second differences of a side's smoothed and raw offset, metres, over the frames where both are known.

    Frames without a measurement have no raw offset: the two compare only on the same frames.
    """
    names = [f"lane_{side}_offset_m", f"lane_{side}_raw_offset_m"]
    differences = [pl.col(name).diff().diff() for name in names]
    known = differences[0].is_not_null() & differences[1].is_not_null()
    return [
        pl.when(known).then(difference).alias(name.replace("offset", "second_difference"))
        for name, difference in zip(names, differences, strict=True)
    ]
