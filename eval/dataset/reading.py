"""Goes over all tables of a dataset once, in batches of rows: what is known of each log, and of each group of frames.

Polars' streaming engine reads the columns in use and no others; a batch is the largest thing in memory.
"""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError

from ..by_run import COVERED
from ..quantities import SUSPECT, TRUTH, Quantity
from ..scan import NUMBER_COLUMNS, derived_columns, finite, stored_columns
from ..segments import SEGMENT, difference
from ..summary import EXACT_FRAMES, POINTS
from .keys import LOG, Grouping, Key, as_key, key_name
from .place import DATE, FILE, date_of, first_line, scan_tables
from .pools import POOLED, Pool

MOST_GROUPS: Final = 40
"""Groups whose frames are summed up at the same time; of more, those that are asked for."""
RANKED: Final = (*TRUTH, *SUSPECT)
"""By the means of these logs are the worst."""
FRAMES, SPAN_NS, SEGMENTS, GAP_NS, FILES = "frames", "span ns", "segments", "gap ns", "files"
_ROWS: Final = 131_072
"""Rows of a batch: 130 MB."""
_AT_ONCE: Final = 2
_FEWEST_POINTS: Final = 256
_NAMED: Final = (*LOG, "frame", "stamp_ns")
_SECOND: Final = 2
"""Rows before a batch that its first rows' second differences need."""
_OWN_SEGMENT: Final = "segment of the log"
_STRETCH: Final = "stretch"


@dataclass(frozen=True)
class TableContents:
    """What a dataset's tables hold.

    ``logs`` has a row for each log and configuration: ``LOG``, ``DATE``, the ``FILES`` it stands in, its ``FRAMES``,
    ``SEGMENTS`` and ``SPAN_NS``, the longest ``GAP_NS``, and of the quantities that logs are ranked by and covered
    columns how many frames have one (``valued``) and their sum (``summed``). ``pools`` are the groups by their keys;
    None where there are more than ``MOST_GROUPS``.
    """

    logs: pl.DataFrame
    pools: dict[Key, Pool] | None


def valued(column: str) -> str:
    """The column of ``TableContents.logs`` that counts the frames with a value."""
    return f"valued {column}"


def summed(column: str) -> str:
    """The column of ``TableContents.logs`` with the sum of absolute values, of what is better high of the values."""
    return f"summed {column}"


def read_contents(
    files: Sequence[str],
    by: Grouping,
    run_keys: pl.DataFrame,
    without: pl.DataFrame,
    only: pl.DataFrame | None = None,
) -> TableContents:
    """Read metrics tables.

    Args:
        files: one at least; at an address a pattern.
        by: how frames are grouped.
        run_keys: ``LOG`` and the keys from the list of runs, a row for each log and configuration.
        without: ``LOG`` of those that are left out.
        only: ``LOG`` of those that are read; all if None.

    Raises:
        TableError: a table cannot be read, frames stand in it twice, or a column of the tables has so many values that
            they are no groups.
    """
    rows = _rows(files, by)
    if without.height:
        rows = rows.join(without.lazy(), on=LOG, how="anti", maintain_order="left")
    if only is not None:
        rows = rows.join(only.lazy(), on=LOG, how="semi", maintain_order="left")
    parts: list[pl.DataFrame] = []
    groups = _Groups(by)
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        for batch in _batches(rows, files):
            parts.append(_ledger(batch))
            groups.add(_with_run_keys(batch, run_keys), threads)
    if not parts:
        raise TableError("no log is left to report: the files of all are of other logs now, of which none gave a table")
    logs = _logs(parts)
    _require_frames_once(logs)
    return TableContents(logs, groups.pools)


class _Groups:
    """The groups of frames so far; none any more once they are too many."""

    def __init__(self, by: Grouping) -> None:
        self._by = by
        self._keys = [key_name(name) for name in by.columns]
        self._frames = 0
        self.pools: dict[Key, Pool] | None = {}

    def add(self, batch: pl.DataFrame, threads: Executor) -> None:
        """Take in a batch, with the columns of the keys."""
        if self.pools is None:
            return
        self._frames += batch.height
        parts = _partitions(batch, self._keys)
        if len({*self.pools, *parts}) > MOST_GROUPS:
            self._give_up()
            return
        for key, frames in parts.items():
            self.pools.setdefault(key, Pool(EXACT_FRAMES)).add(frames, threads)
        if self._frames > EXACT_FRAMES:
            points = max(_FEWEST_POINTS, min(POINTS, POINTS * 8 // len(self.pools)))
            for pool in self.pools.values():
                pool.limit(points)

    def _give_up(self) -> None:
        if not self._by.of_whole_logs:
            raise TableError(
                f"--by {','.join(self._by.columns)}: has more than {MOST_GROUPS} different values in the frames; "
                "expected a column with few, such as lane_left_status"
            )
        self.pools = None


def _with_run_keys(batch: pl.DataFrame, run_keys: pl.DataFrame) -> pl.DataFrame:
    """The batch with the keys that come from the list of runs."""
    if run_keys.width == len(LOG):
        return batch
    found = batch.select(LOG).join(run_keys, on=LOG, how="left", maintain_order="left")
    return batch.hstack(found.drop(LOG))


def _partitions(batch: pl.DataFrame, keys: list[str]) -> dict[Key, pl.DataFrame]:
    if not keys:
        return {(): batch}
    first = batch.select(keys).unique()
    if first.height == 1:
        return {first.row(0): batch}
    return batch.select(*keys, *POOLED).partition_by(keys, as_dict=True, maintain_order=True)


def _rows(files: Sequence[str], by: Grouping) -> pl.LazyFrame:
    tables = scan_tables(files)
    schema = tables.collect_schema()
    lacking = [name for name in (*LOG, "frame", "stamp_ns", "missing", "reasons", "total_ms") if name not in schema]
    if lacking:
        raise TableError(f"{files[0]}: is not a metrics table of a dataset: it has no column {', '.join(lacking)}")
    keys = [
        date_of(pl.col(FILE)).alias(key_name(name)) if name == DATE else as_key(name, schema[name])
        for name in by.columns
        if name not in by.of_runs
    ]
    return tables.select(pl.col("config").cast(pl.String), pl.col(FILE), *keys, *stored_columns(frozenset(schema)))


def _batches(rows: pl.LazyFrame, files: Sequence[str]) -> Iterator[pl.DataFrame]:
    """The rows with derived columns, in their order."""
    before: pl.DataFrame | None = None
    try:
        for found in rows.collect_batches(chunk_size=_ROWS, maintain_order=True, engine="streaming"):
            if not found.height:
                continue
            require_named(found)
            whole = _finite(found.rechunk() if before is None else pl.concat([before, found], rechunk=True))
            before = whole.tail(_SECOND)
            yield _derived(whole).slice(whole.height - found.height)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        raise TableError(unreadable(files, error)) from error


def require_named(rows: pl.DataFrame) -> None:
    """Check that rows tell what they are of.

    Raises:
        TableError: one has no log, configuration, frame number or stamp, as those of another program's table.
    """
    named = [name for name in _NAMED if name in rows.columns]
    if any(rows.select(pl.col(named).null_count()).row(0)):
        file = rows.filter(pl.any_horizontal(pl.col(named).is_null()))[FILE][0]
        raise TableError(f"{file}: is not a metrics table of a dataset: it has rows without {', '.join(named)}")


def _finite(rows: pl.DataFrame) -> pl.DataFrame:
    """Rows whose numbers are finite or null; a sum tells at a tenth of the cost which columns have to be changed."""
    sums = rows.select(pl.sum(*NUMBER_COLUMNS)).row(0, named=True)
    return rows.with_columns(finite(name for name, total in sums.items() if not math.isfinite(total)))


def _derived(rows: pl.DataFrame) -> pl.DataFrame:
    """Rows with the columns that need their neighbours, within a log and segment; ``SEGMENT`` tells these apart."""
    marked = rows.with_columns(
        pl.col(SEGMENT).alias(_OWN_SEGMENT),
        _stretches(*LOG, SEGMENT).alias(SEGMENT),
        _stretches(*LOG, SEGMENT, FILE).alias(_STRETCH),
    )
    return marked.with_columns(*derived_columns(), difference(pl.col("stamp_ns")).alias(GAP_NS))


def _stretches(*columns: str) -> pl.Expr:
    """A number for each stretch of rows that have the same values."""
    changed = pl.any_horizontal(pl.col(name).ne_missing(pl.col(name).shift()) for name in columns)
    return changed.cum_sum().cast(pl.Int64)


def _ledger(batch: pl.DataFrame) -> pl.DataFrame:
    """What a batch holds of each segment of each log, a row for each file; where logs alternate several."""
    counted = dict.fromkeys([*(quantity.column for quantity in RANKED), *COVERED.values()])
    return batch.group_by(_STRETCH, maintain_order=True).agg(  # one whole number: five times as fast as by five texts
        pl.first(*LOG, FILE, _OWN_SEGMENT),
        pl.len().cast(pl.Int64).alias(FRAMES),
        pl.min("frame").alias("first"),
        pl.max("frame").alias("last"),
        pl.min("stamp_ns").alias("first ns"),
        pl.max("stamp_ns").alias("last ns"),
        pl.max(GAP_NS),
        *(pl.col(name).count().cast(pl.Int64).alias(valued(name)) for name in counted),
        *(badness(quantity).sum().alias(summed(quantity.column)) for quantity in RANKED),
    )


def badness(quantity: Quantity) -> pl.Expr:
    """What a log's mean is of: absolute values, of what is better high the values."""
    column = pl.col(quantity.column)
    return column if quantity.worse == "low" else column.abs()


def _logs(parts: Sequence[pl.DataFrame]) -> pl.DataFrame:
    rows = pl.concat(parts)
    totals = [name for name in rows.columns if name.startswith(("valued ", "summed "))]
    segments = rows.group_by(*LOG, _OWN_SEGMENT, maintain_order=True).agg(
        pl.col(FILE).unique(maintain_order=True).alias(FILES),
        pl.min("first", "first ns"),
        pl.max("last", "last ns", GAP_NS),
        pl.sum(FRAMES, *totals),
    )
    return segments.group_by(LOG, maintain_order=True).agg(
        date_of(pl.first(FILES).list.first()).alias(DATE),
        pl.col(FILES).explode().unique(maintain_order=True),
        pl.sum(FRAMES),
        (pl.max("last") - pl.min("first") + 1).alias("numbers"),
        pl.len().cast(pl.Int64).alias(SEGMENTS),
        (pl.col("last ns") - pl.col("first ns")).sum().alias(SPAN_NS),
        pl.max(GAP_NS),
        pl.sum(*totals),
    )


def _require_frames_once(logs: pl.DataFrame) -> None:
    """Check that no frame counts twice, as where a file is there beside the one that it was put into with others."""
    twice = logs.filter(pl.col(FRAMES) > pl.col("numbers"))
    if twice.height:
        log_id, config, files = twice.select(*LOG, FILES).row(0)
        where = " and ".join(files[:2])
        raise TableError(f"log {log_id}, configuration {config}: has frames that stand twice, in {where}")


def unreadable(files: Sequence[str], error: BaseException) -> str:
    """What cannot be read: polars does not always name the file."""
    for file in files:
        try:
            pl.read_parquet(file, columns=["stamp_ns", "total_ms"], glob=False, hive_partitioning=False)
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as found:
            return f"{file}: its data cannot be read: {first_line(found)}"
    return f"{files[0]} and others: their data cannot be read: {first_line(error)}"
