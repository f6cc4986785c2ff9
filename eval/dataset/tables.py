"""The tables and lines that only a report over a dataset has."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import polars as pl

from roadperc_stream.output.text_table import TextRow, TextTable, row

from ..configurations import UNKNOWN, differing
from ..grid import percent, rounded
from ..names import listed
from ..quantities import Quantity
from ..summary import Summary
from .configs import DEFAULT, Settings
from .grouped import GroupedFrames
from .run_rows import DONE, without_file
from .worst import LeastCovered, LogKey, WorstLog, WorstLogs

FAILED_LISTED: Final = 20
_LABEL_COLUMNS: Final = 24
_HOUR_S: Final = 3600


def statuses(runs: pl.DataFrame) -> str:
    """How many runs fared how, those that were done first."""
    counts = Counter(runs["status"])
    ranked = sorted(counts.items(), key=lambda item: (item[0] != DONE, -item[1], item[0]))
    return ", ".join(f"{number} {status}" for status, number in ranked)


def failures(runs: pl.DataFrame) -> Iterator[str]:
    """A line on each log that gave no table, the first of many; under which configurations, where not under all."""
    configs = runs["config"].n_unique()
    failed = runs.filter(pl.col("status") != DONE).sort("status", "path", "config")
    logs = failed.group_by("status", "path", "error", maintain_order=True).agg("config")
    for status, path, error, under in logs.head(FAILED_LISTED).iter_rows():
        where = "" if len(under) == configs else f" ({', '.join(under)})"
        yield f"  {status}{where}: {path}: {(error or 'no reason given').removeprefix(f'{path}: ')}"
    if logs.height > FAILED_LISTED:
        yield f"  and {logs.height - FAILED_LISTED} more, in runs.parquet"


def settings_that_differ(known: Mapping[str, Settings | None]) -> TextTable:
    """The settings, and the options, that are not the same in all configurations.

    Args:
        known: by the configuration those that are not the default; None where nothing says them.
    """
    found = {config: settings for config, settings in known.items() if settings is not None}
    keys = dict.fromkeys(key for settings in found.values() for key in settings)
    values = differing([{key: settings.get(key, DEFAULT) for key in keys} for settings in found.values()])
    rows = [
        TextRow(key, tuple((dict(zip(found, in_each, strict=True)).get(config, UNKNOWN),) for config in known))
        for key, in_each in values.items()
    ]
    return TextTable("Settings that differ", ("",), tuple(rows), (), tuple(known))


def groups_table(summaries: Sequence[Summary], found: GroupedFrames, notes: tuple[str, ...]) -> TextTable:
    """A row for each group: its logs, frames, time where it has whole logs, and frames with all inputs' messages."""
    whole = found.by.of_whole_logs
    headers = ("logs", "frames", *(["log time"] if whole else []), "inputs %")
    rows = tuple(_group(summary, whole) for summary in summaries)
    by = ", ".join(found.by.asked)
    return TextTable(f"By {by}", headers, rows, (*notes, *_about_groups(summaries, found)), label_columns=15)


def log_time(span_s: float) -> str:
    """How long logs are together, in the unit that suits."""
    return f"{span_s / _HOUR_S:.2f} h" if span_s >= _HOUR_S else f"{span_s:.2f} s"


def _group(summary: Summary, whole: bool) -> TextRow:
    extent = [log_time(summary.span_s)] if whole else []
    complete = percent(1 - summary.incomplete / summary.frames)
    return row(summary.name, str(len(summary.log_ids)), str(summary.frames), *extent, complete)


def _about_groups(summaries: Sequence[Summary], found: GroupedFrames) -> Iterator[str]:
    if found.groups > len(summaries):
        yield f"listed: {len(summaries)} of {found.groups} groups, those with the worst mean errors"
    if any(len(summary.configs) > 1 for summary in summaries):
        yield f"groups are over several configurations: --by {','.join((*found.by.asked, 'config'))} keeps these apart"


def worst_logs_table(worst: WorstLogs, names: Mapping[LogKey, str]) -> TextTable:
    """The worst logs by each quantity, and the frames to look at in each."""
    rows = tuple(line for quantity, logs in worst.by_quantity.items() for line in _of_quantity(quantity, logs, names))
    notes = (
        "each log under the configuration where it is worst; the mean is of the absolute error",
        "frames to look at, the worst first: numbers, in brackets seconds from the log's first frame",
    )
    headers = ("mean", "worst", "frames %", "frames to look at")
    return TextTable("Worst logs", headers, rows, notes if rows else (), last_is_text=True, label_columns=15)


def _of_quantity(quantity: Quantity, logs: Sequence[WorstLog], names: Mapping[LogKey, str]) -> Iterator[TextRow]:
    yield _folded(quantity.label)
    for item in logs:
        values = rounded(item.mean, quantity), rounded(item.frames[0].value, quantity)
        frames = ", ".join(f"{at.frame}({at.since_start_s:.2f}s)" for at in item.frames)
        yield row(f"  {names[item.log]}", *values, percent(item.share), frames)


def _folded(label: str) -> TextRow:
    """A label that leaves room for the others' words."""
    name, bracket, more = label.rpartition(" (")
    long = bracket and len(label) > _LABEL_COLUMNS
    return TextRow(name, below=f"{bracket.strip()}{more}") if long else row(label)


def least_covered_table(worst: WorstLogs, names: Mapping[LogKey, str]) -> TextTable:
    """The logs in which the fewest frames have an output, and the longest stretch without it in each."""
    rows = tuple(line for what, logs in worst.by_coverage.items() for line in _of_output(what, logs, names))
    notes = (
        "without: the longest stretch of frames, in brackets seconds from the log's first frame",
        "outputs that a configuration gives in no frame are left out",
    )
    headers = ("frames %", "without")
    return TextTable("Least covered logs", headers, rows, notes if rows else (), last_is_text=True, label_columns=15)


def _of_output(what: str, logs: Sequence[LeastCovered], names: Mapping[LogKey, str]) -> Iterator[TextRow]:
    yield row(what)
    for item in logs:
        first, last = item.first, item.last
        stretch = f"{first.frame}-{last.frame} ({first.since_start_s:.2f}-{last.since_start_s:.2f} s)"
        yield row(f"  {names[item.log]}", percent(item.share), stretch)


def where_the_logs_are(worst: WorstLogs, names: Mapping[str, str], runs: pl.DataFrame) -> Iterator[str]:
    """A line on each log that is named above: its path.

    Args:
        worst: the logs.
        names: what each is called.
        runs: the list of runs.
    """
    paths = dict(runs.filter(pl.col("log_id").is_not_null()).select("log_id", "path").iter_rows())
    log_ids = {log_id for log_id, _ in worst.logs}
    if log_ids:
        yield "Logs named above"
    for log_id in sorted(log_ids, key=lambda log_id: names[log_id]):
        yield f"  {names[log_id]}: {paths.get(log_id, 'path unknown')} (log {log_id})"


def not_listed(runs: pl.DataFrame, logs: pl.DataFrame) -> Iterator[str]:
    """What the list of runs and the tables do not agree on."""
    known = runs.filter(pl.col("log_id").is_not_null())
    keys = ["log_id", "config"]
    gone = without_file(runs)
    if gone.height:
        names = listed([f"{log_id}-{config}" for log_id, config in gone.select(keys).iter_rows()], 3)
        yield f"left out, for another log has taken the place of their files: {_count(gone, names)}"
    extra = logs.join(known, on=keys, how="anti")
    if extra.height:
        names = listed([f"{log_id}-{config}" for log_id, config in extra.select(keys).iter_rows()], 3)
        yield f"not in runs.parquet, taken all the same, for another batch may be at work: {_count(extra, names)}"
    done = known.join(gone, on=keys, how="anti").filter(pl.col("status") == DONE, pl.col("frames") > 0)
    lacking = done.join(logs, on=keys, how="anti")
    if lacking.height:
        names = listed(lacking["path"].to_list(), 3)
        yield f"done, as runs.parquet says, but without a table: {_count(lacking, names)}"
    failed = logs.join(known.filter(pl.col("status") != DONE), on=keys, how="semi")
    if failed.height:
        yield f"{failed.height} tables are of an earlier run than the one that failed: they count"


def _count(rows: pl.DataFrame, names: str) -> str:
    return f"{rows.height} ({names})"
