"""Prints a report on the terminal, or as plain text where it is piped."""

from collections.abc import Iterable, Sequence
from typing import Final, TextIO

from rich.console import Console
from rich.table import Table

from . import log_by_log, sections
from .runs import Run
from .summary import Summary

NARROWEST, WIDEST = 80, 120
"""Columns a report is laid out for; a narrower terminal wraps its lines rather than losing digits."""
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
    print_table(console, log_by_log.accuracy_by_log(summaries))
    print_table(console, log_by_log.times_by_log(summaries))
    if len(summaries) > len(listed):
        print_lines(console, f"listed: the {len(listed)} of {len(summaries)} logs that were seen least")
    if len(summaries) > log_by_log.LOGS_SHOWN:
        print_lines(
            console, f"log by log: in each block the {log_by_log.LOGS_SHOWN} of {len(summaries)} with the worst p95"
        )


def console_for(stream: TextIO) -> Console:
    """A console that keeps numbers whole, takes names as they are, and colours nothing where it is piped."""
    width = min(max(Console(file=stream).width, NARROWEST), WIDEST)
    return Console(file=stream, width=width, highlight=False, markup=False, emoji=False)


def _print_sections(console: Console, summary: Summary) -> None:
    print_table(console, sections.seen(summary))
    lag = _LAG if sections.has_lag(summary) else ""
    print_table(console, sections.lane_boundaries(summary), _JITTER, lag, sections.beyond_lanes(summary))
    absent = sections.no_values(summary)
    if absent:
        print_lines(console, "", f"no values: {absent}")
    if sections.has_truth(summary):
        print_table(console, sections.right(summary), _ERRORS)
        print_table(console, sections.counted(summary))
    else:
        print_lines(console, "", "Is it right? No frame has a truth for what was replayed.")
    print_table(console, sections.fast(summary), sections.speed(summary))
    print_table(console, sections.worst(summary), _SECONDS)
    print_table(console, sections.reasons(summary))


def print_table(console: Console, table: Table, *notes: str) -> None:
    """Print a table that has rows, with a line of air before it and notes below."""
    if table.row_count:
        print_lines(console, "", table, *(note for note in notes if note))


def print_lines(console: Console, *lines: str | Table, unbroken: bool = False) -> None:
    """Print without the blanks that fill lines up to the right margin; what does not fit runs over, uncut.

    Text folds between its words, unless ``unbroken``: what somebody may search for stays on its line.
    """
    with console.capture() as capture:
        for line in lines:
            console.print(line, crop=False, soft_wrap=unbroken and isinstance(line, str))
    for line in capture.get().splitlines():
        console.file.write(f"{line.rstrip()}\n")
