"""The tables that lay several runs side by side: a row per run."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from roadperc_stream.output.text_table import TextRow, TextTable, row

from .configurations import short_digest
from .grid import percent
from .names import listed
from .sections import accuracy, latency, missing_outputs
from .summary import Summary

RUNS_LISTED: Final = 40
"""Runs that get a row of their own in the tables of what they are; of more, those with the least coverage."""
COVERED: Final = {
    "surface": "camera_height_m",
    "drivable": "drivable_ratio",
    "left": "lane_left_offset_m",
    "right": "lane_right_offset_m",
    "objects": "detections",
    "stereo": "stereo_valid_ratio",
    "odometry": "step_m",
}
_NARROW: Final = {"odometry": "odom."}
"""Where columns are many."""


def least_covered(summaries: Sequence[Summary]) -> list[Summary]:
    """The runs that get a row, in their order."""
    if len(summaries) <= RUNS_LISTED:
        return list(summaries)
    least = sorted(range(len(summaries)), key=lambda place: sum(_shares(summaries[place], COVERED.values())))
    return [summaries[place] for place in sorted(least[:RUNS_LISTED])]


def runs(summaries: Sequence[Summary], notes: tuple[str, ...]) -> TextTable:
    """A row per run: what it is and how long; the version where there are several."""
    versions = len({summary.versions for summary in summaries}) > 1
    headers = ("log id", "config", *(["version"] if versions else []), "frames", "s", "frames/s")
    return TextTable("Run", headers, tuple(_run(s, versions) for s in summaries), notes, label_columns=15)


def _run(summary: Summary, with_version: bool) -> TextRow:
    version = [summary.versions[0] or "unknown"] if with_version else []
    extent = (str(summary.frames), f"{summary.span_s:.2f}", f"{summary.rate_hz:.1f}" if summary.rate_hz else "")
    return row(summary.name, listed(summary.log_ids, 1), short_digest(summary.configs[0]), *version, *extent)


def coverage_by_run(summaries: Sequence[Summary]) -> TextTable:
    """A row per run: share of frames with all inputs' messages, and with a value of each stage that has any."""
    shown = {what: column for what, column in COVERED.items() if any(column in s.statistics for s in summaries)}
    rows = (row(summary.name, *map(percent, _shares(summary, shown.values()))) for summary in summaries)
    return TextTable(
        "Coverage, %", ("inputs", *(_NARROW.get(what, what) for what in shown)), tuple(rows), label_columns=15
    )


def tables_by_run(summaries: Sequence[Summary]) -> Iterator[TextTable]:
    """Missing outputs that are not the same in all runs, accuracy and latency, each with a line per run."""
    missing = missing_outputs(summaries)
    vary = tuple(item for item in missing.rows if len({cells[-1:] for cells in item.cells}) > 1)
    for table in (replace(missing, rows=vary), accuracy(summaries), latency(summaries)):
        yield replace(table, title=f"{table.title} by run", notes=())


def _shares(summary: Summary, columns: Iterable[str]) -> list[float]:
    """The share of frames with all inputs' messages, and that with a value in each column."""
    return [1 - summary.incomplete / summary.frames, *(summary.coverage(column) for column in columns)]
