"""Finds events in the logs of a dataset, or of runs: prints a table, and writes JSON and excerpts of the logs."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import console_for
from roadperc_stream.system.files import require_suffix
from roadperc_stream.system.text import number, print_line, shown

from ..continued import find_joined
from ..dataset.keys import LOG, LogKey, log_names
from ..dataset.pairs import in_a_folder
from ..dataset.place import DONE, NO_TABLES, Dataset, dataset_at, metrics_files, read_runs, scan_tables, without_file
from ..dataset.reading import metrics_tables
from ..frame_commands import view_command, view_dataset_command
from ..frames import runs_of_keys
from ..results import ResultFiles, Results
from ..runs import Run
from ..scan import objects_of, rows_of
from .events import Clips, Condition, Event, Logs, condition_of, events_of, matches

_LISTED: Final = 40
"""Events in the table."""


@dataclass(frozen=True)
class Query:
    """An SQL condition on frames, and how its frames form events.

    ``peak`` is the column whose worst value is the peak of an event; empty for the condition's first column of numbers.
    Frames closer than ``gap_s`` are one event; events shorter than ``least_s`` are left out.
    """

    condition: str
    peak: str = ""
    gap_s: float = 1.0
    least_s: float = 0.0


def find(
    source: str, query: Query, json: Path | None, gallery: Path | None, clips: Clips | None, changed: Sequence[str]
) -> None:
    """Print the events of a condition in a dataset or in runs; write them as JSON, as a page, and as excerpts.

    ``changed`` are settings KEY=VALUE for logs that were not kept and are replayed.

    Raises:
        TableError: there are no tables, a table cannot be read, or the condition does not fit.
        RoadpercError: a file cannot be written, or a log cannot be read or replayed.
    """
    if gallery is not None:
        require_suffix(gallery, ".html", ".htm")
    dataset = dataset_at(source)
    logs = _of_dataset(dataset) if dataset else _of_runs(find_joined([source]).runs)
    schema = logs.schema()
    condition = condition_of(query.condition, query.peak, schema)
    found = matches(logs, condition, schema).join(logs.absent, on=LOG, how="anti")
    rows = events_of(found, query.gap_s, query.least_s, lowest=condition.lowest)
    events = [_event(row, logs, clips.folder if clips else None) for row in rows.iter_rows(named=True)]
    of_events = [vars(event) | {"seconds": event.seconds} for event in events]
    values = {"condition": query.condition, "peak": condition.peak, "events": of_events}
    results = Results("find", "Events", [*_lines(events, condition, query.condition)], values=values)
    results.write(ResultFiles(json))
    results.print(console_for(sys.stdout))
    if not events or not (gallery or clips):
        return
    with ExitStack() as files:
        runs = logs.runs(list(dict.fromkeys(event.key for event in events)), files)
        if gallery is not None:
            from .gallery import write_gallery  # noqa: PLC0415 - only pictures need the drawing

            write_gallery(gallery, events, runs, query.condition, condition.peak, changed)
            print_line(f"wrote {gallery}")
        if clips:
            from .clips import write_clips  # noqa: PLC0415 - only clips need the chain

            write_clips(events, runs, clips, changed)


def _event(row: Mapping[str, Any], logs: Logs, clips: Path | None) -> Event:
    key = row["log_id"], row["config"]
    name = logs.name(key)
    clip = shown(f"{name}-{row['first_frame']}.mcap").replace("/", "_").replace(" ", "_")
    command = logs.command(key, row["peak_frame"])
    return Event(log=name, **row, command=command, clip=str(clips / clip) if clips else None)


def _of_dataset(dataset: Dataset) -> Logs:
    files = metrics_files(dataset)
    if not files:
        raise TableError(f"{dataset.address}: {NO_TABLES}")
    metrics_tables(files)
    objects = dataset.tables("objects", "date=*", "*.parquet")
    runs = read_runs(dataset)
    done = runs.filter(pl.col("log_id").is_not_null(), pl.col("status") == DONE)
    names = log_names(done["log_id"].unique(maintain_order=True), runs)
    several = runs["config"].n_unique() > 1

    def command(key: LogKey, frame: int) -> str:
        return view_dataset_command(dataset.address, names.get(key[0], key[0]), frame, key[1] if several else "")

    def runs_of(keys: Sequence[LogKey], stack: ExitStack) -> dict[LogKey, Run]:
        local = replace(stack.enter_context(in_a_folder(dataset)), copy_of=dataset.address)
        return runs_of_keys(local, runs, keys, names)

    return Logs(
        partial(scan_tables, files),
        partial(scan_tables, objects) if objects else None,
        files,
        without_file(runs).select(LOG),
        lambda key: " ".join((names.get(key[0], key[0]), *([key[1]] if several else []))),
        command,
        runs_of,
    )


def _of_runs(runs: Sequence[Run]) -> Logs:
    """The logs of runs; the name of a run takes the place of its ``log_id``."""
    named = {run.name: run for run in runs}
    none = pl.lit("").alias("config")
    frames = [rows_of(run).with_columns(none, log_id=pl.lit(run.name)) for run in runs]
    tables = [objects_of(run.name, table, table.objects) for run in runs for table in run.tables if table.objects]
    objects = [rows.with_columns(none, log_id=pl.col("log")).drop("log") for rows in tables]
    return Logs(
        lambda _: pl.concat(frames, how="diagonal_relaxed"),
        (lambda _: pl.concat(objects, how="diagonal_relaxed")) if objects else None,
        [str(table.path) for run in runs for table in run.tables],
        pl.DataFrame(schema=dict.fromkeys(LOG, pl.String)),
        lambda key: key[0],
        lambda key, frame: view_command(named[key[0]], frame),
        lambda keys, _: {key: named[key[0]] for key in keys},
    )


def _lines(events: Sequence[Event], condition: Condition, text: str) -> Iterator[str]:
    """The number of events, then a table of the worst ones, with the command that shows the peak of each."""
    logs = number(len({event.log_id for event in events}), "log")
    if not events:
        yield f"no event: {text}"
        return
    yield f"{number(len(events), 'event')} in {logs}: {text}"
    rows = [("log", "first", "last", "seconds", condition.peak, "command")]
    for event in events[:_LISTED]:
        peak = "" if event.peak is None else f"{event.peak:.4g}"
        frames = str(event.first_frame), str(event.last_frame), f"{event.seconds:.2f}"
        rows.append((event.log, *frames, peak, event.command))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for log, *numbers, command in rows:
        cells = (cell.rjust(width) for cell, width in zip(numbers, widths[1:-1], strict=True))
        yield "  ".join((log.ljust(widths[0]), *cells, command))
    if len(events) > _LISTED:
        yield f"listed: the worst {_LISTED} of {len(events)}; --json writes all"
