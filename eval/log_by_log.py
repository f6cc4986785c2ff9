"""The tables that lay several runs side by side: a row per run."""

from collections.abc import Callable, Iterable, Sequence
from itertools import islice
from typing import Final

from rich.table import Table

from roadperc_stream.cli.terminal import grid
from roadperc_stream.core.reasons import ranked

from .grid import percent
from .quantities import STAGES, TRUTH, Quantity
from .sections import REASONS_SHOWN, accuracy, accuracy_grid, given, reasons_grid, speed_grid, times
from .statistics import Statistics
from .summary import Summary

LOGS_SHOWN: Final = 12
"""Logs a block of the log-by-log tables has room for; of more, those with the largest p95 are shown."""
LOGS_LISTED: Final = 40
"""Logs that get a row of their own in the tables of what was seen; of more, those that were seen least are listed."""
_COVERED: Final = {
    "surface": "camera_height_m",
    "drivable": "drivable_ratio",
    "left": "lane_left_offset_m",
    "right": "lane_right_offset_m",
    "objects": "detections",
    "stereo": "stereo_valid_ratio",
    "odometry": "step_m",
}


def listed(summaries: Sequence[Summary]) -> list[Summary]:
    """The runs that get a row, in their order."""
    if len(summaries) <= LOGS_LISTED:
        return list(summaries)
    least = sorted(range(len(summaries)), key=lambda place: sum(_shares(summaries[place], _COVERED.values())))
    return [summaries[place] for place in sorted(least[:LOGS_LISTED])]


def logs(summaries: Iterable[Summary]) -> Table:
    """A row per run: what it is and how long."""
    table = grid("Log", "log id", "config", "frames", "s", "frames/s", label_columns=20)
    for summary in summaries:
        table.add_row(
            summary.name,
            summary.log_ids[0],
            summary.configs[0][:8],
            str(summary.frames),
            f"{summary.span_s:.2f}",
            f"{summary.rate_hz:.1f}" if summary.rate_hz else "",
        )
    return table


def coverage_by_log(summaries: Sequence[Summary]) -> Table:
    """A row per run: share of frames with all inputs' messages, and with a value of each stage that has any."""
    shown = {what: column for what, column in _COVERED.items() if any(column in s.statistics for s in summaries)}
    table = grid("Seen, % of frames", "messages", *shown, label_columns=17)
    for summary in summaries:
        table.add_row(summary.name, *(percent(share) for share in _shares(summary, shown.values())))
    return table


def reasons_by_log(summaries: Sequence[Summary], together: Summary) -> Table:
    """A block per reason that is not as frequent in all runs, a row per run that has it; of too many the most frequent.

    Args:
        summaries: of the runs.
        together: over all of them.
    """
    table = reasons_grid("Why not, log by log")
    for kind, reason in islice(ranked(together.reasons).items(), REASONS_SHOWN):
        shares = [summary.reason_share(kind) for summary in summaries]
        if min(shares) == max(shares):
            continue
        table.add_row(str(reason))
        least = sorted(shares)[-LOGS_SHOWN:][0]
        having = [s for s, share in zip(summaries, shares, strict=True) if share >= least and kind in s.reasons]
        for summary in having[:LOGS_SHOWN]:
            table.add_row(f"  {summary.name}", *given(summary.reasons[kind], summary))
    return table


def accuracy_by_log(summaries: Sequence[Summary]) -> Table:
    """A block per truth metric, a row per run."""
    return _blocks(accuracy_grid("Right, log by log"), TRUTH, summaries, accuracy)


def times_by_log(summaries: Sequence[Summary]) -> Table:
    """A block per stage, a row per run."""
    return _blocks(speed_grid("Fast, log by log"), STAGES, summaries, times)


def _blocks(
    table: Table,
    quantities: Iterable[Quantity],
    summaries: Sequence[Summary],
    cells: Callable[[Summary, Quantity], list[str]],
) -> Table:
    for quantity in quantities:
        having = _shown(summaries, quantity)
        if having:
            table.add_row(quantity.label)
        for summary in having:
            table.add_row(f"  {summary.name}", *cells(summary, quantity))
    return table


def _shown(summaries: Sequence[Summary], quantity: Quantity) -> list[Summary]:
    """The runs with values, in their order; of too many, the worst."""
    having = [summary for summary in summaries if quantity.column in summary.statistics]
    if len(having) <= LOGS_SHOWN:
        return having
    return sorted(having, key=lambda summary: -_tail(summary.statistics[quantity.column], quantity))[:LOGS_SHOWN]


def _shares(summary: Summary, columns: Iterable[str]) -> list[float]:
    """The share of frames with all inputs' messages, and that with a value in each column."""
    return [1 - summary.incomplete / summary.frames, *(summary.coverage(column) for column in columns)]


def _tail(found: Statistics, quantity: Quantity) -> float:
    return -found.p5 if quantity.worse == "low" else found.abs_p95
