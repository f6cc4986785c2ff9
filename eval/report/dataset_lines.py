"""What a report says of a dataset beside the figures: the outcome of its runs, and its worst logs."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import polars as pl

from roadperc_stream.output.text_table import Row, Table
from roadperc_stream.system.text import listed, number

from ..configurations import table_of_settings
from ..dataset.keys import DEFAULT, LOG, in_order_of_runs, settings_by_config
from ..dataset.place import DONE, Dataset, without_file
from ..report_columns import percent, rounded
from .sources import Frames
from .worst_logs import WorstLogs

FAILED_LISTED: Final = 20
_HOUR_S: Final = 3600


def contents(dataset: Dataset, frames: Frames) -> str:
    """Numbers of logs, configurations and frames, and the time of the logs."""
    runs = frames.runs
    distinct = number(runs["log_id"].n_unique(), "log"), number(runs["config"].n_unique(), "configuration")
    span_s = float(runs.unique("log_id", keep="first")["span_s"].sum())
    return f"{dataset.name}: {', '.join(distinct)}, {number(len(frames.run), 'frame')}, {log_time(span_s)} of log"


def log_time(span_s: float) -> str:
    """A total time in hours or seconds."""
    return f"{span_s / _HOUR_S:.2f} h" if span_s >= _HOUR_S else f"{span_s:.2f} s"


def statuses(runs: pl.DataFrame, most: int) -> Iterator[str]:
    """Numbers of runs by status, then a line for each of the first failed logs.

    A line names the configurations unless the log failed under all of them.
    """
    if not runs.height:
        yield "runs: status unknown, no runs.parquet"
        return
    ranked = sorted(Counter(runs["status"]).items(), key=lambda item: (item[0] != DONE, -item[1], item[0]))
    yield f"runs: {', '.join(f'{count} {status}' for status, count in ranked)}"
    configs = runs["config"].n_unique()
    failed = runs.filter(pl.col("status") != DONE).sort("status", "path", "config")
    logs = failed.group_by("status", "path", "error", maintain_order=True).agg("config")
    for status, path, error, under in logs.head(most).iter_rows():
        where = "" if len(under) == configs else f" ({', '.join(under)})"
        yield f"  {status}{where}: {path}: {reason_of_failure(path, error)}"
    if logs.height > most:
        yield f"  and {logs.height - most} more, in runs.parquet"


def reason_of_failure(path: str, error: str | None) -> str:
    """The error of a failed log, without its path."""
    return (error or "no reason given").removeprefix(f"{path}: ")


def not_listed(runs: pl.DataFrame, logs: pl.DataFrame) -> Iterator[str]:
    """Lines on disagreements between the list of runs and the ``logs`` of the tables."""
    known = runs.filter(pl.col("log_id").is_not_null())
    replaced = without_file(runs)
    if replaced.height:
        yield f"left out, because other logs have replaced their files: {_count(replaced)}"
    extra = logs.join(known, on=LOG, how="anti")
    if extra.height:
        yield f"included, but not in runs.parquet (a batch may be running): {_count(extra)}"
    done = known.join(replaced, on=LOG, how="anti").filter(pl.col("status") == DONE, pl.col("frames") > 0)
    lacking = done.join(logs, on=LOG, how="anti")
    if lacking.height:
        yield f"done in runs.parquet, but without a table: {lacking.height} ({listed(lacking['path'].to_list(), 3)})"
    failed = logs.join(known.filter(pl.col("status") != DONE), on=LOG, how="semi")
    if failed.height:
        yield f"{number(failed.height, 'table')} from before a failed run: included"


def _count(rows: pl.DataFrame) -> str:
    names = [f"{log_id}-{config}" for log_id, config in rows.select(LOG).iter_rows()]
    return f"{rows.height} ({listed(names, 3)})"


def settings_of_dataset(frames: Frames, runs: pl.DataFrame) -> Table:
    """The settings and options that differ between the configurations of a dataset, with its list of ``runs``."""
    configs = in_order_of_runs(frames.runs["config"].unique(maintain_order=True).to_list(), runs)
    known = settings_by_config(runs, configs)
    keys = dict.fromkeys(key for settings in known.values() for key in settings or ())
    return table_of_settings(
        {
            config: None if settings is None else {key: settings.get(key, DEFAULT) for key in keys}
            for config, settings in known.items()
        }
    )


def worst_logs_table(worst: WorstLogs, names: Mapping[int, str]) -> Table:
    """The worst logs by each quantity, and the frames to look at in each."""
    rows: list[Row] = []
    for quantity, logs in worst.by_quantity.items():
        rows.append((quantity.column,))
        for log in logs:
            values = rounded(log.mean, quantity), rounded(log.frames[0].value, quantity), percent(log.share)
            frames = ", ".join(f"{at.frame}({at.since_start_s:.2f}s)" for at in log.frames)
            rows.append((f"  {names[log.run]}", *values, frames))
    notes = (
        "each log under its worst configuration; mean of the absolute error",
        "frames to look at: the worst first, in brackets s from the log's first frame",
    )
    headers = ("mean", "worst", "frames %", "frames to look at")
    return Table("Worst logs", headers, rows, notes if rows else (), last_is_text=True, label_columns=15)


def least_covered_table(worst: WorstLogs, names: Mapping[int, str]) -> Table:
    """The logs in which the fewest frames have an output, and the longest stretch without it in each."""
    rows: list[Row] = []
    for output, logs in worst.covered.items():
        rows.append((output,))
        for log in logs:
            seconds = f"{log.first.since_start_s:.2f}-{log.last.since_start_s:.2f} s"
            without = f"{log.first.frame}-{log.last.frame} ({seconds})"
            rows.append((f"  {names[log.run]}", percent(log.share), without))
    notes = (
        "without: the longest stretch of frames, in brackets seconds from the log's first frame",
        "outputs that a configuration never has are left out",
    )
    headers, shown = ("frames %", "without"), notes if rows else ()
    return Table("Least covered logs", headers, rows, shown, last_is_text=True, label_columns=15)


def log_paths(frames: Frames, runs: Sequence[int]) -> Iterator[str]:
    """A line for each log of some runs with its name and its path from the list of runs."""
    logs = frames.runs[runs].select("log", "path", "log_id").unique("log_id").sort("log").rows() if runs else []
    yield from ["Logs named above"] if logs else []
    yield from (f"  {name}: {path or 'path unknown'} (log {log_id})" for name, path, log_id in logs)
