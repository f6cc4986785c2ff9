"""What a batch's dataset holds, on the terminal."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import polars as pl
from rich.console import Console

from roadperc_stream.core.text import number
from roadperc_stream.core.time import NS_PER_S
from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import console_for, print_lines, print_table

from ..names import legend, short_names
from ..overview import inputs, precision
from ..sections import LISTED, sections
from ..summary import Summary
from . import tables
from .configs import in_order_of_runs, settings_by_config
from .grouped import GroupedFrames, group_frames, summaries_of
from .naming import log_names
from .place import Dataset, metrics_files
from .reading import FRAMES, SPAN_NS
from .run_rows import read_runs
from .worst import worst_logs

_GROUP_COLUMNS: Final = 59
"""Characters that the widest row of numbers about a group needs next to its name."""
_WORST_COLUMNS: Final = 59
"""Characters that the widest table of worst logs needs next to a log's name."""


def print_dataset(dataset: Dataset, by: Sequence[str], worst: int) -> None:
    """Print statistics over a dataset's tables by group, and its worst logs.

    Args:
        dataset: where it is.
        by: columns to group by; what made the tables, where they differ in that, if empty.
        worst: how many logs are listed for each error, and frames of each.

    Raises:
        TableError: there is nothing to report, a table cannot be read, or there is no such column.
    """
    runs, files = read_runs(dataset), metrics_files(dataset)
    console = console_for(sys.stdout)
    if not files:
        if not runs.height:
            raise TableError(f"{dataset.address}: no tables in metrics/date=.../, and no runs.parquet")
        print_lines(console, *_fared(runs), unbroken=True)
        raise TableError(f"{dataset.address}: no log gave a table, so there is nothing to report")
    found = group_frames(files, runs, by)
    configs = in_order_of_runs(found.logs["config"].unique(maintain_order=True).to_list(), runs)
    names = log_names(found.logs["log_id"].unique(maintain_order=True), runs)
    summaries = summaries_of(found, names, configs)
    print_lines(console, _contents(dataset, found.logs), *_fared(runs), unbroken=True)
    print_lines(console, *tables.not_listed(runs, found.logs), unbroken=True)
    print_table(console, tables.settings_that_differ(settings_by_config(runs, configs)))
    _print_groups(console, summaries, found)
    _print_worst(console, found.logs, runs, names, worst)


def _contents(dataset: Dataset, logs: pl.DataFrame) -> str:
    numbers = {
        "log": logs["log_id"].n_unique(),
        "configuration": logs["config"].n_unique(),
        "frame": int(logs[FRAMES].sum()),
    }
    counts = ", ".join(number(count, what) for what, count in numbers.items())
    return (
        f"{dataset.address}: {counts}, {tables.log_time(int(logs.unique('log_id')[SPAN_NS].sum()) / NS_PER_S)} of log"
    )


def _fared(runs: pl.DataFrame) -> Iterator[str]:
    if runs.height:
        yield f"runs: {tables.statuses(runs)}"
        yield from tables.failures(runs)
    else:
        yield "runs: no runs.parquet says how they fared"


def _print_groups(console: Console, summaries: Sequence[Summary], found: GroupedFrames) -> None:
    shown = _short([summary.name for summary in summaries], found.by.columns, console.width - _GROUP_COLUMNS)
    called = [replace(summary, name=shown[summary.name]) for summary in summaries]
    if found.by.columns:
        print_table(console, tables.groups_table(called, found, tuple(legend(shown))))
    else:
        print_lines(console, inputs(called[0]))
    if any(summary.rank_error for summary in called):
        print_lines(console, precision(max(called, key=lambda summary: summary.rank_error)))
    for table in sections(called, consistency=False):
        print_table(console, table)
    if len(called) > LISTED:
        print_lines(console, f"by group: at most {LISTED} of {len(called)} each time, those with the worst p95")


def _short(names: Sequence[str], columns: Sequence[str], width: int) -> dict[str, str]:
    """What groups are called in tables: by themselves or their ends, those by several columns by their number."""
    if len(columns) > 1 and any(len(name) > width for name in names):
        return {name: f"group {number}" for number, name in enumerate(names, 1)}
    return short_names(names, width)


def _print_worst(
    console: Console, logs: pl.DataFrame, runs: pl.DataFrame, names: Mapping[str, str], number: int
) -> None:
    worst = worst_logs(logs, number)
    several = logs["config"].n_unique() > 1
    whole = {key: f"{names[key[0]]} {key[1]}" if several else names[key[0]] for key in worst.logs}
    shown = short_names(list(whole.values()), console.width - _WORST_COLUMNS)
    called = {key: shown[name] for key, name in whole.items()}
    print_table(console, tables.worst_logs_table(worst, called))
    print_table(console, tables.least_covered_table(worst, called))
    print_lines(console, "", *tables.where_the_logs_are(worst, names, runs), unbroken=True)
