"""Prints a report: its sections in the order in which they are asked for."""

from collections.abc import Iterable, Sequence
from typing import Final

from rich.console import Console

from roadperc_stream.cli.terminal import print_lines, print_table

from . import log_by_log, sections
from .runs import Run
from .summary import Summary

_JITTER: Final = "jitter: standard deviation of the offset's second difference, smoothed and raw"
_LAG: Final = "lag: frames by which the smoothed offset lies behind the true one"
_ERRORS: Final = "median, p95 and worst are of the absolute error, bias is the median error"
_SECONDS: Final = "s: seconds from the log's first frame"


def print_one(console: Console, summary: Summary) -> None:
    """The report of one run."""
    print_lines(console, sections.identity(summary), sections.extent(summary), sections.inputs(summary))
    _print_sections(console, summary)


def print_empty(console: Console, runs: Iterable[Run]) -> None:
    """Name the tables that hold no frames and are left out."""
    print_lines(console, *(f"{run.path}: no frames in this table" for run in runs))


def print_several(console: Console, summaries: Sequence[Summary], together: Summary) -> None:
    """The report over several runs, and each beside the others."""
    print_lines(console, sections.identity(together), sections.extent(together), sections.inputs(together))
    if together.rank_error:
        print_lines(console, sections.precision(together))
    listed = log_by_log.listed(summaries)
    print_table(console, log_by_log.logs(listed))
    _print_sections(console, together)
    print_table(console, log_by_log.coverage_by_log(listed))
    print_table(console, log_by_log.reasons_by_log(summaries, together))
    print_table(console, log_by_log.accuracy_by_log(summaries))
    print_table(console, log_by_log.times_by_log(summaries))
    if len(summaries) > len(listed):
        print_lines(console, f"listed: the {len(listed)} of {len(summaries)} logs that were seen least")
    if len(summaries) > log_by_log.LOGS_SHOWN:
        print_lines(
            console, f"log by log: in each block the {log_by_log.LOGS_SHOWN} of {len(summaries)} with the worst p95"
        )


def _print_sections(console: Console, summary: Summary) -> None:
    print_table(console, sections.seen(summary))
    lag = _LAG if sections.has_lag(summary) else ""
    print_table(console, sections.lane_boundaries(summary), _JITTER, lag, sections.beyond_lanes(summary))
    absent = sections.no_values(summary)
    if absent:
        print_lines(console, "", f"no values: {absent}")
    print_table(console, sections.reasons(summary))
    if sections.has_truth(summary):
        print_table(console, sections.right(summary), _ERRORS)
        print_table(console, sections.counted(summary))
    else:
        print_lines(console, "", "Is it right? No frame has a truth for what was replayed.")
    print_table(console, sections.fast(summary), sections.speed(summary))
    print_table(console, sections.worst(summary), _SECONDS)
