"""Prints a comparison: the verdict in a few lines, and on request tables and differing fields."""

from collections.abc import Iterator
from itertools import groupby
from typing import get_args

from rich.console import Console

from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import TextRow, TextTable, row

from ..configurations import UNKNOWN, short_digest
from ..runs import Run
from .agreement import Agreement
from .bootstrap import LEVEL, MANY_LOGS
from .comparing import Comparison
from .summary import both, summary
from .verdicts import Mark

FIELDS_SHOWN = 10
"""Differing fields shown without ``--exact``."""
_BOUNDS = f"{LEVEL:.0%} from", "to"


def print_comparison(console: Console, found: Comparison, *, full: bool, all_fields: bool) -> None:
    """Print the verdict in a few lines; with ``full`` also the tables of metrics and times, and fields that differ.

    With ``all_fields`` print every field that differs, else the first ones.
    """
    print_lines(console, *summary(found, full=full), unbroken=True)
    if full:
        for pair in found.pairing.pairs if len(found.pairing.pairs) == 1 else ():
            print_lines(console, "", _identity("base", pair.base), _identity("new", pair.new), unbroken=True)
        for table in (metrics_table(found), _times(found)):
            print_table(console, table)
    if full or all_fields:
        print_lines(console, *_fields(found, all_fields=all_fields), unbroken=True)


def _identity(side: str, run: Run) -> str:
    config, version = short_digest(run.config_digest), run.version or UNKNOWN
    return f"{side} {run.source_name}: log {run.log_id}, configuration {config}, version {version}"


def _fields(found: Comparison, *, all_fields: bool) -> Iterator[str]:
    """The first difference of each field that differs, below its frame, in the order of time."""
    first = [(difference, agreement) for agreement in found.fields.values() if (difference := agreement.first)]
    differing = sorted(first, key=lambda item: item[0].at)
    shown = differing if all_fields else differing[:FIELDS_SHOWN]
    are_several = len(found.pairing.pairs) > 1
    if are_several and shown:
        yield from ("", "first difference of each field, and its number of frames in all pairs")
    for (run, stamp_ns, frame), group in groupby(shown, key=lambda item: item[0].at):
        several = f"{run}: " if are_several else ""
        yield from ("", f"{several}frame {frame}, stamp {stamp_ns}")
        for difference, agreement in group:
            values = both(difference.base, difference.new, (6, 17))
            yield f"  {difference.place}: {values}, {_largest(agreement)}"
    if len(shown) < len(differing):
        yield from ("", f"{len(differing) - len(shown)} more fields differ; pass --exact to list all")
    within = [f"{n} ({_largest(a)})" for n, a in found.fields.items() if a.state == "within tolerance"]
    if within:
        yield from ("", f"within tolerance: {', '.join(within)}")


def _largest(agreement: Agreement) -> str:
    frames = agreement.differing or agreement.within
    counted = f"in {frames} frame{'s' * (frames > 1)}"
    return f"{counted}, by up to {agreement.largest:.3g}" if agreement.largest else counted


def metrics_table(found: Comparison) -> TextTable:
    """The metrics that changed, by mark: means of both runs, and the interval of the difference."""
    rows: list[TextRow] = []
    for mark in get_args(Mark):
        changed = [verdict for verdict in found.named(mark) if verdict.difference]
        rows += [row(mark)] if changed else []
        for verdict in changed:
            bounds = f"{verdict.interval.low:+.3g}", f"{verdict.interval.high:+.3g}"
            means = f"{verdict.base:.4g}", f"{verdict.new:.4g}"
            rows.append(row(f"  {verdict.metric.name}", str(verdict.frames), *means, *bounds))
    blocks = "whole logs" if len(found.pairing.pairs) >= MANY_LOGS else "blocks of neighbouring frames"
    notes = (f"intervals: {LEVEL:.0%} for all groups of metrics together, from resampled {blocks}",) if rows else ()
    return TextTable("Metric", ("frames", "base", "new", *_BOUNDS), tuple(rows), notes)


def _times(found: Comparison) -> TextTable:
    """Mean times, and the ratio of the new run's to the base's."""
    rows = []
    for verdict in (verdict for verdict in found.verdicts if verdict.metric.timed and verdict.base > 0):
        changes = verdict.difference, verdict.interval.low, verdict.interval.high
        ratios = (f"{1 + change / verdict.base:.2f}" for change in changes)
        rows.append(row(verdict.metric.name, f"{verdict.base:.2f}", f"{verdict.new:.2f}", *ratios))
    return TextTable("Latency", ("base ms", "new ms", "times", *_BOUNDS), tuple(rows))
