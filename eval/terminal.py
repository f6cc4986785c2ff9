"""Prints a report: its sections in the order in which they are asked for."""

from collections.abc import Mapping, Sequence

from rich.console import Console

from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import TextTable

from . import by_run, overview
from .names import legend
from .sections import LISTED, sections, worst_frames
from .summary import GroupSummary, Summary


def print_one(console: Console, summary: Summary) -> None:
    """The report of one run."""
    print_lines(console, overview.identity(summary), overview.extent(summary), overview.inputs(summary))
    _print_tables(console, [summary])


def print_several(
    console: Console, groups: Sequence[GroupSummary], settings: TextTable, names: Mapping[str, str]
) -> None:
    """The report over several runs, and each next to the others; no statistic is over two groups.

    Args:
        console: where to print.
        groups: the runs by configuration and version.
        settings: the settings that differ between the groups.
        names: the whole name of each run, and what it is called here.
    """
    runs = [summary for group in groups for summary in group.runs]
    print_lines(console, overview.contents(runs))
    print_table(console, settings)
    rows = by_run.least_covered(runs)
    print_table(console, by_run.runs(rows, tuple(legend(names))))
    for group in groups[:LISTED]:
        _print_extent(console, group.together, len(groups) > 1)
    _print_tables(console, [group.together for group in groups])
    print_table(console, by_run.coverage_by_run(rows))
    if len(runs) > len(groups):
        for table in by_run.tables_by_run(runs):
            print_table(console, table)
    _print_what_is_left_out(console, len(runs), len(rows), len(groups))


def _print_extent(console: Console, summary: Summary, several: bool) -> None:
    name = [f"{summary.name}:"] if several else []
    print_lines(console, "", *name, overview.extent(summary), overview.inputs(summary))
    if summary.rank_error:
        print_lines(console, overview.precision(summary))


def _print_tables(console: Console, summaries: Sequence[Summary]) -> None:
    for table in (*sections(summaries), worst_frames(summaries)):
        print_table(console, table)


def _print_what_is_left_out(console: Console, runs: int, listed: int, groups: int) -> None:
    if runs > listed:
        print_lines(console, f"listed: the {listed} of {runs} runs with the least coverage")
    if groups > LISTED:
        print_lines(console, f"by configuration: at most {LISTED} of {groups} each time, those with the worst p95")
    if runs > max(groups, LISTED):
        print_lines(console, f"by run: at most {LISTED} of {runs} each time, those with the worst p95")
