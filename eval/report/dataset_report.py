"""The report on a batch's dataset."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import polars as pl
from rich.console import Console

from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import print_lines
from roadperc_stream.output.text_table import Row as TableRow
from roadperc_stream.output.text_table import Table
from roadperc_stream.system.text import number
from roadperc_stream.system.time import NS_PER_S

from ..dataset.groups import GroupedFrames
from ..dataset.keys import LOG
from ..dataset.place import (
    DATE,
    DONE,
    NO_TABLES,
    RUN_COLUMNS,
    Dataset,
    scan_objects,
    scan_tables,
    without_file,
)
from ..dataset.reading import FRAMES, SPAN_NS
from ..dataset.summed import SummedDataset
from ..dataset.worst import LogKey, Row, key_of, worst_logs
from ..findings import findings_of_dataset
from ..frame_commands import view_dataset_command
from ..options import ReportOptions
from ..report_columns import Quantity, legend, listed, percent, rounded, short_names
from ..results import Results
from ..summaries import Summary
from .by_expression import object_slices, of_objects
from .full_tables import LISTED, full_tables
from .run_report import inputs, precision
from .short_report import of_summaries, with_findings
from .stages import judged_stages, rows_tables, stage_figures, with_unit

FAILED_LISTED: Final = 20
_FEW: Final = 3
"""Failed logs and worst logs in the short report."""
_NAME_COLUMNS: Final = 22
"""Width of a group's name in the short report."""
_HOUR_S: Final = 3600
_MORE: Final = "pass --full for all tables, --by EXPRESSION for slices"
_NUMBER_COLUMNS: Final = 59
"""Width of the widest row of numbers beside the name of a group or of a log."""


def _statuses(runs: pl.DataFrame, most: int) -> Iterator[str]:
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
        yield f"  {status}{where}: {path}: {(error or 'no reason given').removeprefix(f'{path}: ')}"
    if logs.height > most:
        yield f"  and {logs.height - most} more, in runs.parquet"


def groups_table(summaries: Sequence[Summary], found: GroupedFrames, notes: tuple[str, ...]) -> Table:
    """A row for each group: numbers of logs and frames, the time of whole logs, and frames with all inputs."""
    whole = found.by.of_whole_logs
    headers = ("logs", "frames", *(["log time"] if whole else []), "inputs %")
    rows = tuple(_group(summary, whole) for summary in summaries)
    if found.groups > len(summaries):
        notes += (f"listed: {len(summaries)} of {found.groups} groups, those with the worst mean errors",)
    if any(len(summary.configs) > 1 for summary in summaries):
        separate = ",".join((*found.by.as_options, "config"))
        notes += (f"groups include several configurations; pass --by {separate} to separate them",)
    return Table(f"By {', '.join(found.by.as_options)}", headers, rows, notes, label_columns=15)


def log_time(span_s: float) -> str:
    """A total time in hours or seconds."""
    return f"{span_s / _HOUR_S:.2f} h" if span_s >= _HOUR_S else f"{span_s:.2f} s"


def _group(summary: Summary, whole: bool) -> TableRow:
    extent = [log_time(summary.span_s)] if whole else []
    complete = percent(1 - summary.incomplete / summary.frames)
    return (summary.name, str(len(summary.log_ids)), str(summary.frames), *extent, complete)


def worst_logs_table(worst: Mapping[Quantity, Sequence[Row]], names: Mapping[LogKey, str]) -> Table:
    """The worst logs by each quantity, and the frames to look at in each."""
    rows: list[TableRow] = []
    for quantity, logs in worst.items():
        rows.append((quantity.column,))
        for item in logs:
            values = (rounded(value, quantity) for value in (item["mean"], item["at"][0]["value"]))
            frames = ", ".join(f"{at['frame']}({at['since_start_s']:.2f}s)" for at in item["at"])
            rows.append((f"  {names[key_of(item)]}", *values, percent(item["share"]), frames))
    notes = (
        "each log under its worst configuration; mean of the absolute error",
        "frames to look at: the worst first, in brackets s from the log's first frame",
    )
    headers = ("mean", "worst", "frames %", "frames to look at")
    return Table("Worst logs", headers, tuple(rows), notes if rows else (), last_is_text=True, label_columns=15)


def least_covered_table(worst: Mapping[str, Sequence[Row]], names: Mapping[LogKey, str]) -> Table:
    """The logs in which the fewest frames have an output, and the longest stretch without it in each."""
    rows: list[TableRow] = []
    for output, logs in worst.items():
        rows.append((output,))
        for item in logs:
            first, last = item["at"]["first"], item["at"]["last"]
            stretch = f"{first['frame']}-{last['frame']} ({first['since_start_s']:.2f}-{last['since_start_s']:.2f} s)"
            rows.append((f"  {names[key_of(item)]}", percent(item["share"]), stretch))
    notes = (
        "without: the longest stretch of frames, in brackets seconds from the log's first frame",
        "outputs that a configuration never has are left out",
    )
    headers, shown = ("frames %", "without"), notes if rows else ()
    return Table("Least covered logs", headers, tuple(rows), shown, last_is_text=True, label_columns=15)


def log_paths(log_ids: Iterable[str], names: Mapping[str, str], runs: pl.DataFrame) -> Iterator[str]:
    """A line for each log with its name and its path from the list of runs."""
    paths = dict(runs.filter(pl.col("log_id").is_not_null()).select("log_id", "path").iter_rows())
    ordered = sorted(set(log_ids), key=lambda log_id: names[log_id])
    yield from ["Logs named above"] if ordered else []
    yield from (f"  {names[log_id]}: {paths.get(log_id, 'path unknown')} (log {log_id})" for log_id in ordered)


def not_listed(runs: pl.DataFrame, logs: pl.DataFrame) -> Iterator[str]:
    """Lines on disagreements between the list of runs and the tables."""
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


class DatasetReport:
    """The report on a dataset: by group, and its worst logs; it raises the same errors as ``RunReport``."""

    def __init__(self, dataset: Dataset, options: ReportOptions, console: Console) -> None:
        """Read the list of runs.

        Raises:
            TableError: there are no tables; then the failed logs are printed.
        """
        self._dataset, self._options, self._width = dataset, options, console.width
        self._summed = SummedDataset(dataset, options.by)
        self._runs, self._files = self._summed.runs, self._summed.files
        self._findings = findings_of_dataset(self._runs)
        if not self._files:
            if not self._runs.height:
                raise TableError(f"{dataset.address}: {NO_TABLES}")
            print_lines(console, *_statuses(self._runs, FAILED_LISTED), unbroken=True)
            raise TableError(f"{dataset.address}: no tables in metrics/date=.../; no log of the batch has frames")

    def write_page(self, path: Path) -> None:
        """Write the page."""
        from ..html.dataset_page import write_dataset_page  # noqa: PLC0415 - only the page needs plotly

        write_dataset_page(path, self._dataset)

    def short(self) -> Results:
        """The stages of one group, or a row for each; then the worst log by each error; or slices of objects."""
        by = self._options.by
        if self._by_objects:
            found = object_slices(scan_objects(self._dataset, self._runs), by, self._dataset.address)
        else:
            found = self._of_groups()
        return with_findings(found, self._findings)

    def full(self) -> Results:
        """All tables."""
        if self._by_objects:
            return self.short()
        worst, paths = self._worst_logs()
        parts = (self._summed.settings, *self._groups(), *worst)
        found = Results("report", "Report", self._head(FAILED_LISTED), parts, ("", *paths))
        return with_findings(found, self._findings)

    @property
    def _by_objects(self) -> bool:
        by = self._options.by
        return bool(by) and of_objects(by, (*scan_tables(self._files).collect_schema(), *RUN_COLUMNS, DATE))

    def _head(self, failed: int) -> tuple[str, ...]:
        logs = self._summed.logs
        return (_contents(self._dataset, logs), *_statuses(self._runs, failed), *not_listed(self._runs, logs))

    def _of_groups(self) -> Results:
        summaries, logs = self._summed.summaries, self._summed.logs
        short = _short([summary.name for summary in summaries], self._summed.groups.by.columns, _NAME_COLUMNS)
        found = of_summaries("Report", "groups", summaries, lambda _: "")
        several = logs["config"].n_unique() > 1
        columns = {figures.quantity.column for s in summaries for figures in stage_figures(s, judged_stages(summaries))}
        worst = [(q, rows[0]) for q, rows in worst_logs(logs, 1)[0].items() if q.column in columns]
        lines, values = [], []
        for quantity, item in sorted(worst, key=lambda pair: -pair[1]["mean"] / (pair[0].limit or math.inf))[:_FEW]:
            config, at, log = item["config"], item["at"][0], self._summed.names[item["log_id"]]
            command = view_dataset_command(self._dataset.address, log, at["frame"], config if several else "")
            values.append({"column": quantity.column, "log": log, "config": config, **at, "command": command})
            lines.append(f"worst log: {with_unit(abs(at['value']), quantity)}: {command}")
        note = () if self._runs.height else ("no runs.parquet: failed logs are unknown",)
        renamed = [replace(summary, name=short[summary.name]) for summary in summaries]
        tables = found.tables if len(summaries) == 1 else rows_tables("Group", renamed)
        return replace(
            found,
            head=(*self._head(_FEW), *found.head),
            tables=(self._summed.settings, *tables),
            tail=(*legend(short), *lines, *found.tail, *note, _MORE),
            values={**found.values, "worst_logs": values},
        )

    def _groups(self) -> Iterator[str | Table]:
        summaries, by = self._summed.summaries, self._summed.groups.by.columns
        names = _short([summary.name for summary in summaries], by, self._width - _NUMBER_COLUMNS)
        renamed = [replace(summary, name=names[summary.name]) for summary in summaries]
        if by:
            yield groups_table(renamed, self._summed.groups, tuple(legend(names)))
        else:
            yield inputs(renamed[0])
        if any(summary.rank_error for summary in renamed):
            yield precision(max(renamed, key=lambda summary: summary.rank_error))
        yield from full_tables(renamed)
        if len(renamed) > LISTED:
            yield f"by group: at most {LISTED} of {len(renamed)} per row, those with the worst p95"

    def _worst_logs(self) -> tuple[tuple[Table, Table], Iterator[str]]:
        """The tables of the worst logs, and the paths of these logs."""
        logs, names = self._summed.logs, self._summed.names
        by_quantity, by_coverage = worst_logs(logs, self._options.worst)
        keys = [key_of(item) for ranking in (by_quantity, by_coverage) for rows in ranking.values() for item in rows]
        several = logs["config"].n_unique() > 1
        full = {key: f"{names[key[0]]} {key[1]}" if several else names[key[0]] for key in dict.fromkeys(keys)}
        short = short_names(list(full.values()), self._width - _NUMBER_COLUMNS)
        shown = {key: short[name] for key, name in full.items()}
        tables = worst_logs_table(by_quantity, shown), least_covered_table(by_coverage, shown)
        return tables, log_paths((log_id for log_id, _ in keys), names, self._runs)


def _contents(dataset: Dataset, logs: pl.DataFrame) -> str:
    kinds = {"log_id": "log", "config": "configuration"}
    distinct = [number(logs[column].n_unique(), what) for column, what in kinds.items()]
    counts = ", ".join((*distinct, number(int(logs[FRAMES].sum()), "frame")))
    return f"{dataset.address}: {counts}, {log_time(int(logs.unique('log_id')[SPAN_NS].sum()) / NS_PER_S)} of log"


def _short(names: Sequence[str], columns: Sequence[str], width: int) -> dict[str, str]:
    """Short names of groups; long names of groups by several columns are replaced by numbers."""
    if len(columns) > 1 and any(len(name) > width for name in names):
        return {name: f"group {number}" for number, name in enumerate(names, 1)}
    return short_names(names, width)
