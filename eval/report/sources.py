"""The frames to report on, of runs or of a batch's dataset: facts of each run, and the columns one after another.

The frames of a dataset may be many millions, so a few columns are the largest object in memory: the tables are scanned
several times, for some columns each time.
"""

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.errors import TableError
from roadperc_stream.geometry import Float
from roadperc_stream.schemas.columns import ObjectMetrics, columns_of
from roadperc_stream.system.time import NS_PER_S

from ..configurations import short_digest
from ..dataset.keys import LOG, log_names
from ..dataset.place import (
    DATE,
    FILE,
    NO_TABLES,
    Dataset,
    date_of,
    metrics_files,
    object_files,
    scan_objects,
    without_file,
)
from ..dataset.reading import metrics_tables, reading_files, require_named
from ..expressions import as_key, key_name, require_roots, roots
from ..report_columns import NUMBERS
from ..runs import Run
from ..scan import SEGMENT, difference, finite, neighbour_columns, objects_of, row_columns, rows_of, stored_columns

RUN: Final = "run"
"""The number of a run, from 0."""
_MOST_VALUES: Final = 100_000_000
"""Most values of the columns that are read at a time: 800 MB."""
_ROWS: Final = 131_072
"""Rows of a batch."""
_EARLIER: Final = 2
"""Rows before a row from which its columns are derived."""
Numbers = NDArray[np.int64]
"""(N,) a whole number for each frame."""


@dataclass(frozen=True)
class FrameSource:
    """The rows of metrics tables with all their columns, those of a report, and ``log`` or ``FILE``.

    ``keys`` identify the run of a row. ``facts`` has a row for each known run: ``keys``, its name as ``log``, its
    ``version``, and more columns for expressions. ``files`` are the tables, and ``title`` names them in errors.
    ``objects`` are the rows of the tables of objects with ``keys``, ``object_files`` these tables. With ``many`` the
    rows may not fit into memory.
    """

    rows: pl.LazyFrame
    keys: tuple[str, ...]
    facts: pl.DataFrame
    files: Sequence[str]
    title: str
    objects: pl.LazyFrame | None
    object_files: Sequence[str]
    many: bool = False

    def collect(self, *columns: pl.Expr | str) -> pl.DataFrame:
        """Columns of all rows.

        Raises:
            TableError: a table cannot be read.
        """
        with reading_files(self.files):
            return self.rows.select(columns).collect(engine="streaming" if self.many else "in-memory")

    def batches(self, *columns: pl.Expr | str) -> Iterator[pl.DataFrame]:
        """Columns of all rows, in batches.

        Raises:
            TableError: a table cannot be read.
        """
        if not self.many:
            yield self.collect(*columns)
            return
        with reading_files(self.files):
            rows = self.rows.select(columns)
            yield from rows.collect_batches(chunk_size=_ROWS, maintain_order=True, engine="streaming")


def source_of_runs(runs: Sequence[Run]) -> FrameSource:
    """The frames of runs."""
    rows = [_rows_of_run(number, run) for number, run in enumerate(runs)]
    tables = [(number, table) for number, run in enumerate(runs) for table in run.tables]
    objects = [objects_of(runs[k].name, t, t.objects).with_columns(_number(k)) for k, t in tables if t.objects]
    facts = [(k, run.name, run.version, run.mounting_height_m) for k, run in enumerate(runs)]
    kinds = {RUN: pl.Int32, "log": pl.String, "version": pl.String, "mounting_height_m": pl.Float64}
    return FrameSource(
        pl.concat(rows, how="diagonal_relaxed"),
        (RUN,),
        pl.DataFrame(facts, kinds, orient="row"),
        [str(table.path) for _, table in tables],
        "the tables",
        pl.concat(objects, how="diagonal_relaxed") if objects else None,
        [str(table.objects) for _, table in tables if table.objects],
    )


def _rows_of_run(number: int, run: Run) -> pl.LazyFrame:
    named = _number(number), pl.lit(run.name).alias("log"), pl.lit(short_digest(run.config_digest)).alias("config")
    return rows_of(run).with_columns(stored_columns()).with_columns(*row_columns(), *named)


def _number(number: int) -> pl.Expr:
    return pl.lit(number, pl.Int32).alias(RUN)


def source_of_dataset(dataset: Dataset, runs: pl.DataFrame) -> FrameSource:
    """The frames of a dataset in a local folder, and its list of ``runs``.

    Raises:
        TableError: there are no tables, or a table cannot be read or lacks columns.
    """
    files = metrics_files(dataset)
    if not files:
        raise TableError(f"{dataset.name}: {NO_TABLES}")
    tables, _ = metrics_tables(files)
    replaced = without_file(runs).select(LOG)
    if replaced.height:
        tables = tables.join(replaced.lazy(), on=LOG, how="anti", maintain_order="left")
    rows = tables.with_columns(pl.col("config").cast(pl.String), *stored_columns()).with_columns(row_columns())
    known = runs.filter(pl.col("log_id").is_not_null())
    names = log_names(known["log_id"].unique(maintain_order=True), known)
    facts = known.with_columns(pl.col("log_id").replace_strict(names, return_dtype=pl.String).alias("log"))
    title = "the metrics tables or of runs.parquet"
    return FrameSource(rows, LOG, facts, files, title, scan_objects(dataset, runs), object_files(dataset), many=True)


@dataclass(frozen=True)
class Frames:
    """All frames of a source: (N,) numbers of their run, segment and frame, and their stamps.

    ``runs`` has a row for each run: its ``log_ids`` and ``config``, the ``files`` with its rows, its number of
    ``frames`` and ``segments``, their ``span_s`` and the ``longest_gap_s``; and the facts of the source. ``starts_ns``
    has for each segment the stamp of the run's first frame, as if the segments followed each other without a gap.
    ``keys`` has the values of the expressions that may change within a run.
    """

    source: FrameSource
    run: Numbers
    segment: Numbers
    frame: Numbers
    stamp_ns: Numbers
    starts_ns: Numbers
    own_segments: Numbers
    runs: pl.DataFrame
    keys: pl.DataFrame

    def since_start_s(self, at: int) -> float:
        """Seconds from the run's first frame; a segment starts at the time at which the previous one ended."""
        return float(self.stamp_ns[at] - self.starts_ns[self.segment[at]]) / NS_PER_S

    def columns(self, wanted: Container[str]) -> Iterator[dict[str, Float]]:
        """The wanted numeric columns of a report, (N,) float64; unknown values are NaN, others may be infinite.

        The columns come in groups; the next group overwrites the arrays of the one before.

        Raises:
            TableError: a table cannot be read.
        """
        names = [q.column for q in NUMBERS if q.column in wanted]
        most = max(min(_MOST_VALUES // len(self.run), len(names)), 1)
        values = np.empty((most, len(self.run)))
        for at in range(0, len(names), most):
            group = dict(zip(names[at : at + most], values, strict=False))
            end = 0
            for batch in self._batches(group):
                begin, end = end, end + batch.height
                for name, column in group.items():
                    column[begin:end] = batch[name].to_numpy()
            yield group

    def _batches(self, names: Iterable[str]) -> Iterator[pl.DataFrame]:
        """Stored and derived columns in batches; each is derived together with the last rows of the batch before."""
        derived = {name: column for column in neighbour_columns() if (name := column.meta.output_name()) in names}
        roots = {name for column in derived.values() for name in column.meta.root_names()} - {SEGMENT, "stamp_ns"}
        batches = self.source.batches(*{*names, *roots} - {*derived})
        if not derived:
            yield from batches
            return
        earlier = pl.DataFrame(schema=dict.fromkeys(roots, pl.Float64))
        end = 0
        for batch in batches:
            known = pl.concat([earlier, batch.select(finite(earlier.columns))])
            begin, end = end - earlier.height, end + batch.height
            own = {SEGMENT: pl.Series(self.segment[begin:end]), "stamp_ns": pl.Series(self.stamp_ns[begin:end])}
            yield batch.with_columns(known.with_columns(**own).select(*derived.values())[earlier.height :])
            earlier = known.tail(_EARLIER)

    def beside(self, columns: Iterable[str]) -> pl.DataFrame:
        """Some numeric columns beside ``RUN``, ``SEGMENT`` and the stamp; values that are not finite are null.

        Raises:
            TableError: a table cannot be read.
        """
        own = {RUN: pl.Series(self.run), SEGMENT: pl.Series(self.segment), "stamp_ns": pl.Series(self.stamp_ns)}
        stored = [name for name in dict.fromkeys(columns) if name not in own]
        return self.source.collect(*finite(stored)).with_columns(**own)


def load(source: FrameSource, by: Sequence[str] = ()) -> Frames:
    """The frames of a source, and the values of the expressions ``by``.

    Raises:
        TableError: a table cannot be read, a frame appears twice, or a column does not exist.
    """
    schema = source.rows.collect_schema()
    of_rows = [text for text in by if not of_runs(source, text)]
    require_roots(of_rows, {*schema} - {RUN, FILE}, (*source.facts.columns, *columns_of(ObjectMetrics)), source.title)
    files = [FILE] if source.many else []
    identity = [*dict.fromkeys((*source.keys, "log_id", "config")), *files]
    rows = source.collect(*identity, "frame", SEGMENT, "stamp_ns", *(as_key(text, schema) for text in of_rows))
    if rows.is_empty():
        raise TableError("no log to report: other logs have replaced all files, and these have no tables")
    if source.many:
        require_named(rows)
    piece, pieces = numbered(rows.select(identity))
    run_of_piece, runs = numbered(pieces.select(source.keys))
    run = run_of_piece[piece]
    segment, segments = numbered(pl.DataFrame({RUN: run, SEGMENT: rows[SEGMENT]}))
    of_segment = rows.select("frame", "stamp_ns", pl.Series(SEGMENT, segment))
    segments = segments.hstack(_extents(of_segment)).with_columns(start_ns=_start_ns())
    return Frames(
        source,
        run,
        segment,
        rows["frame"].to_numpy(),
        rows["stamp_ns"].to_numpy(),
        segments["start_ns"].to_numpy(),
        segments[SEGMENT].to_numpy(),
        _facts(source, runs, pieces.with_columns(pl.Series(RUN, run_of_piece)), segments),
        rows.select(key_name(text) for text in of_rows),
    )


def of_runs(source: FrameSource, expression: str) -> bool:
    """Whether the facts of the runs have all columns of an expression, so that it is equal in all frames of a run."""
    return {*source.facts.columns} >= {*roots(expression)}


def numbered(rows: pl.DataFrame) -> tuple[Numbers, pl.DataFrame]:
    """The number of each row's values, (N,), and the distinct rows in the order of their numbers.

    Equal rows mostly follow each other, so that only the first of each series is looked at.
    """
    names = rows.columns
    changed = rows.select(pl.any_horizontal(pl.col(name).ne_missing(pl.col(name).shift()) for name in names))
    series = changed.to_series().to_numpy()
    series[:1] = True
    first = rows.filter(pl.Series(series))
    distinct = first.unique(maintain_order=True)
    numbers = first.join(distinct.with_row_index(), on=names, how="left", maintain_order="left", nulls_equal=True)
    return numbers["index"].to_numpy().astype(np.int64)[np.cumsum(series) - 1], distinct


def _start_ns() -> pl.Expr:
    earlier_ns = (pl.col("span_ns").cum_sum() - pl.col("span_ns")).over(RUN)
    return pl.col("first_ns") - earlier_ns


def _extents(rows: pl.DataFrame) -> pl.DataFrame:
    """Frames, first and last stamp and frame, and the longest gap of each segment."""
    stamps = pl.col("stamp_ns")
    found = (
        rows.with_columns(difference(stamps).alias("gap_ns"))
        .group_by(SEGMENT, maintain_order=True)
        .agg(
            pl.len().alias("frames"),
            stamps.min().alias("first_ns"),
            (stamps.max() - stamps.min()).alias("span_ns"),
            pl.col("frame").min().alias("first"),
            pl.col("frame").max().alias("last"),
            pl.max("gap_ns"),
        )
    )
    return found.drop(SEGMENT)


def _facts(source: FrameSource, runs: pl.DataFrame, pieces: pl.DataFrame, segments: pl.DataFrame) -> pl.DataFrame:
    """A row for each of the ``runs``, for ``Frames``; ``pieces`` are the series of rows of one run in one file.

    Raises:
        TableError: a frame appears twice, as in a file and in a compacted copy of it.
    """
    files = [FILE] if FILE in pieces.columns else []
    named = pieces.group_by(RUN, maintain_order=True).agg(
        pl.col("log_id").unique(maintain_order=True).alias("log_ids"),
        pl.first("config"),
        *(pl.col(name).unique(maintain_order=True).alias("files") for name in files),
    )
    extents = segments.group_by(RUN, maintain_order=True).agg(
        pl.sum("frames"),
        (pl.max("last") - pl.min("first") + 1).alias("numbers"),
        pl.len().alias("segments"),
        (pl.sum("span_ns") / NS_PER_S).alias("span_s"),
        (pl.max("gap_ns").fill_null(0) / NS_PER_S).alias("longest_gap_s"),
    )
    found = named.hstack(extents.drop(RUN))
    twice = found.filter(pl.col("frames") > pl.col("numbers"))
    if files and twice.height:
        (log_id,), config, of_run = twice.select("log_ids", "config", "files").row(0)
        where = " and ".join(of_run[:2])
        raise TableError(f"log {log_id}, configuration {config}: has the same frames twice, in {where}; remove one")
    known = runs.join(source.facts, on=source.keys, how="left", maintain_order="left")
    known = known.with_columns(pl.col("log").fill_null(named["log_ids"].list.first()))
    if files:
        known = known.with_columns(found.select(date_of(pl.col("files").list.first()).alias(DATE)))
    return found.drop("numbers", RUN).hstack(known.drop("frames", "config", strict=False))
