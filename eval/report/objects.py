"""Slices of detections by columns or SQL expressions: the errors of their distances."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.columns import ObjectMetrics, columns_of
from roadperc_stream.schemas.columns.places import OBJECT_PLACE
from roadperc_stream.system.files import OBJECTS_SUFFIX

from ..dataset.reading import reading_files
from ..expressions import as_key, key_name, require_roots, roots
from ..report_columns import percent
from ..results import Results
from .grouping import group_name, require_few
from .sources import FrameSource
from .stages import LISTED

_LOG: Final = "log"
_CLASS: Final = "class"
OBJECT_COLUMNS: Final = frozenset(columns_of(ObjectMetrics)) | {*OBJECT_PLACE, _CLASS}


def of_objects(by: Sequence[str], source: FrameSource) -> bool:
    """Whether an expression reads a column that only the table of objects has."""
    others = {*source.rows.collect_schema(), *source.facts.columns, _LOG}
    return any(name in OBJECT_COLUMNS - others for text in by for name in roots(text))


def object_slices(source: FrameSource, by: Sequence[str]) -> Results:
    """The errors of the distances of kept detections in each slice, the largest p95 first.

    Raises:
        TableError: a table cannot be read, a column does not exist, or there are too many slices.
    """
    if source.objects is None:
        raise TableError(f"--by {','.join(by)}: no tables of objects (*{OBJECTS_SUFFIX}) beside {source.files[0]}")
    rows = source.objects.with_columns(pl.col("label").alias(_CLASS))
    schema = rows.collect_schema()
    require_roots(by, schema, (), "the tables of objects")
    keys = [key_name(text) for text in by]
    later = not _has_truth(source, rows)
    signed = pl.col("object_distance_hindsight_m") if later else pl.col("distance_m") - pl.col("true_distance_m")
    error = signed.cast(pl.Float64).abs()
    known = error.filter(error.is_finite())
    grouped = rows.filter(pl.col("kept")).group_by(as_key(text, schema) for text in by)
    with reading_files(source.object_files):
        found = (
            grouped.agg(
                pl.len().alias("objects"),
                pl.struct(_LOG, "frame").n_unique().alias("frames"),
                pl.col("distance_m").is_not_null().mean().alias("coverage"),
                known.median().alias("median"),
                known.quantile(0.95, "linear").alias("p95"),
                known.max().alias("worst"),
            )
            .sort(pl.col("p95").fill_null(-1), *keys, descending=[True, *(False for _ in keys)])
            .collect()
        )
    require_few(found.height, by)
    slices = {group_name(tuple(item[key] for key in keys)): item for item in found.iter_rows(named=True)}
    kind = "error by hindsight" if later else "error"
    note = f"median, p95 and worst: absolute {kind} of the distances of kept detections; known %: those with a distance"
    more = (f"listed: the worst {LISTED} of {len(slices)}",) if len(slices) > LISTED else ()
    shown = [(name, *_object_cells(item)) for name, item in list(slices.items())[:LISTED]]
    headers = ("objects", "frames", "known %", "median m", "p95 m", "worst m")
    heading = f"{sum(item['objects'] for item in slices.values())} objects by {', '.join(by)}"
    table = Table("Slice", headers, shown, (note, *more), label_columns=15)
    numbers = {name: {k: v for k, v in item.items() if k not in keys} for name, item in slices.items()}
    return Results("report", "Slices of objects", (heading,), (table,), (), {"slices": numbers})


def _has_truth(source: FrameSource, rows: pl.LazyFrame) -> bool:
    """Whether any object has a true distance."""
    with reading_files(source.object_files):
        return bool(rows.select(pl.col("true_distance_m").is_not_null().any()).collect().item())


def _object_cells(item: dict[str, Any]) -> Iterator[str]:
    yield from (str(item["objects"]), str(item["frames"]), percent(item["coverage"]))
    yield from ("" if item[name] is None else f"{item[name]:.3f}" for name in ("median", "p95", "worst"))
