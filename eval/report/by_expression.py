"""Slices of runs by columns or SQL expressions: errors of the stages, or of the objects, in each slice."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.columns import ObjectMetrics, columns_of
from roadperc_stream.system.files import OBJECTS_SUFFIX
from roadperc_stream.system.text import number

from ..configurations import short_digest
from ..dataset.groups import require_few
from ..dataset.keys import Key, group_name
from ..expressions import as_key, key_name, require_roots, roots
from ..frame_commands import view_command
from ..report_columns import percent
from ..results import Results
from ..runs import Run, collect
from ..scan import objects_of, rows_of, scanned
from ..summaries import EXACT_FRAMES, Figures, Summary
from .short_report import of_summaries
from .stages import LISTED, rows_tables

_LOG: Final = "log"
_CLASS: Final = "class"
OBJECT_COLUMNS: Final = frozenset(columns_of(ObjectMetrics)) | {_CLASS}


def of_objects(by: Sequence[str], frame_columns: Iterable[str]) -> bool:
    """Whether an expression reads a column that only the table of objects has."""
    return any(name in OBJECT_COLUMNS.difference(frame_columns, {_LOG}) for text in by for name in roots(text))


def slices_of_runs(runs: Sequence[Run], by: Sequence[str]) -> Results:
    """The errors in each slice of the frames of runs; by a column of objects, in each slice of the objects.

    Raises:
        TableError: a table cannot be read, a column does not exist, or there are too many slices.
    """
    columns = frozenset[str]().union(*(run.columns for run in runs)) | {_LOG}
    if of_objects(by, columns):
        tables = [(run.name, table, table.objects) for run in runs for table in run.tables]
        scanned_objects = [objects_of(name, table, path) for name, table, path in tables if path]
        if not scanned_objects:
            raise TableError(f"--by {','.join(by)}: {runs[0].beside(OBJECTS_SUFFIX)} does not exist; expected it")
        return object_slices(pl.concat(scanned_objects, how="diagonal_relaxed"), by, str(runs[0].path))
    require_roots(by, columns, OBJECT_COLUMNS, "the tables")
    summaries = _slices(runs, by)
    named = {run.name: run for run in runs}
    found = of_summaries("Slices", "slices", summaries, lambda at: view_command(named[at.run], at.frame))
    frames = number(sum(run.frames for run in runs), "frame")
    heading = f"{frames} in {number(len(summaries), 'slice')} by {', '.join(by)}"
    return replace(found, head=(heading, *found.head), tables=rows_tables("Slice", summaries))


def _slices(runs: Sequence[Run], by: Sequence[str]) -> list[Summary]:
    found: dict[Key, Figures] = {}
    keys = [key_name(text) for text in by]
    for run in runs:
        for key, frames in _keyed(run, by).partition_by(keys, as_dict=True, maintain_order=True).items():
            found.setdefault(key, Figures(EXACT_FRAMES, worst=1)).add(frames, run)
            require_few(len(found), by)
    return [figures.summary(group_name(key, by, {})) for key, figures in found.items()]


def _keyed(run: Run, by: Sequence[str]) -> pl.DataFrame:
    """The columns of a report and the keys, a row per frame."""
    rows = rows_of(run).with_columns(pl.lit(run.name).alias(_LOG))
    lacking = {name for text in by for name in roots(text)} - run.columns - {_LOG}
    rows = rows.with_columns(pl.lit(None).alias(name) for name in lacking)
    schema = rows.collect_schema()
    keys = rows.select(as_key(text, schema) for text in by)
    config = pl.lit(short_digest(run.config_digest)).alias("config")
    return collect(pl.concat([scanned(rows), keys], how="horizontal").with_columns(config), run.source_name)


def object_slices(rows: pl.LazyFrame, by: Sequence[str], source: str) -> Results:
    """The errors of the distances of kept detections in each slice, the largest p95 first.

    ``rows`` are those of tables of objects, with the name of the log in ``log``; errors name ``source``.

    Raises:
        TableError: a table cannot be read, a column does not exist, or there are too many slices.
    """
    rows = rows.with_columns(pl.col("label").alias(_CLASS))
    schema = rows.collect_schema()
    require_roots(by, schema, (), "the tables of objects")
    keys = [key_name(text) for text in by]
    error = (pl.col("distance_m") - pl.col("true_distance_m")).abs()
    known = error.filter(error.is_finite())
    grouped = rows.filter(pl.col("kept")).group_by(as_key(text, schema) for text in by)
    found = collect(
        grouped.agg(
            pl.len().alias("objects"),
            pl.struct(_LOG, "frame").n_unique().alias("frames"),
            pl.col("distance_m").is_not_null().mean().alias("coverage"),
            known.median().alias("median"),
            known.quantile(0.95, "linear").alias("p95"),
            known.max().alias("worst"),
        ).sort(pl.col("p95").fill_null(-1), *keys, descending=[True, *(False for _ in keys)]),
        source,
    )
    require_few(found.height, by)
    slices = {group_name(tuple(item[key] for key in keys), by, {}): item for item in found.iter_rows(named=True)}
    note = "median, p95 and worst: absolute error of the distances of kept detections; known %: those with a distance"
    more = (f"listed: the worst {LISTED} of {len(slices)}",) if len(slices) > LISTED else ()
    shown = [(name, *_object_cells(item)) for name, item in list(slices.items())[:LISTED]]
    headers = ("objects", "frames", "known %", "median m", "p95 m", "worst m")
    heading = f"{sum(item['objects'] for item in slices.values())} objects by {', '.join(by)}"
    table = Table("Slice", headers, tuple(shown), (note, *more), label_columns=15)
    numbers = {name: {k: v for k, v in item.items() if k not in keys} for name, item in slices.items()}
    return Results("report", "Slices of objects", (heading,), (table,), (), {"slices": numbers})


def _object_cells(item: dict[str, Any]) -> Iterator[str]:
    yield from (str(item["objects"]), str(item["frames"]), percent(item["coverage"]))
    yield from ("" if item[name] is None else f"{item[name]:.3f}" for name in ("median", "p95", "worst"))
