"""Prints a comparison as tables and lines."""

import math
from collections import Counter
from collections.abc import Iterator
from itertools import groupby
from typing import get_args

from rich.console import Console

from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import TextRow, TextTable, row

from ..configurations import UNKNOWN, short_digest
from ..runs import Run
from .agreement import Agreement, Agreements, Value
from .bootstrap import LEVEL, MANY_LOGS
from .comparing import Comparison
from .verdicts import Mark, Verdict

TEXT_SHOWN = 48
"""Characters shown of a text value."""
FIELDS_SHOWN = 10
"""Differing fields shown without ``--exact``."""
_BOUNDS = f"{LEVEL:.0%} from", "to"


def print_comparison(console: Console, found: Comparison, *, all_fields: bool) -> None:
    """Print the runs, their metrics and times, the verdict, and the fields that differ: the first ones, or all."""
    print_lines(console, *_heading(found), unbroken=True)
    for table in (_metrics(found), _times(found)):
        print_table(console, table)
    print_lines(console, "", *_verdict(found), *_fields(found, all_fields=all_fields), unbroken=True)


def _heading(found: Comparison) -> Iterator[str]:
    pairs = found.pairing.pairs
    if len(pairs) == 1:
        yield _identity("base", pairs[0].base)
        yield _identity("new", pairs[0].new)
    for pair in (pair for pair in pairs if not pair.by_one_digest):
        algorithms = f"digest algorithms {pair.base.digest_algorithm} and {pair.new.digest_algorithm}"
        yield f"{pair.name}: the log ids have {algorithms}; whether both runs are of one log is unknown"
    yield from _settings(found)
    yield f"{found.frames} frames compared" + (f" in {len(pairs)} pairs of runs" if len(pairs) > 1 else "")
    for pair, part in zip(pairs, found.overlaps, strict=True):
        if part.only_base or part.only_new:
            only = f"{part.only_base} frames only in the base, {part.only_new} only in the new run"
            yield f"{pair.name}: {only}"
    yield from (f"only in the base: {run.name} (log {run.log_id})" for run in found.pairing.missing)
    yield from (f"only in the new run: {run.name} (log {run.log_id})" for run in found.pairing.added)


def _settings(found: Comparison) -> Iterator[str]:
    """The settings that differ, with both values; pairs with the same differences are listed together."""
    names: dict[tuple[str, ...], list[str]] = {}
    for pair, changed in zip(found.pairing.pairs, found.changes, strict=True):
        if changed:
            names.setdefault(changed, []).append(pair.name)
    for (heading, *lines), runs in names.items():
        among = "" if len(runs) == len(found.pairing.pairs) else f" in {', '.join(runs)}"
        yield f"settings that differ{among}: {heading}".rstrip()
        yield from (f"  {line}" for line in lines)


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
            values = " → ".join(_both(difference.base, difference.new))
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


def _both(base: Value, new: Value) -> tuple[str, str]:
    """Both values as text, with enough digits to show the difference."""
    short = _text(base, 6), _text(new, 6)
    return short if short[0] != short[1] else (_text(base, 17), _text(new, 17))


def _text(value: Value, digits: int) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    text = str(value)
    return text if len(text) <= TEXT_SHOWN else f"{text[:TEXT_SHOWN]}…"


def _metrics(found: Comparison) -> TextTable:
    """The metrics that changed, by mark: means of both runs, and the interval of the difference."""
    rows: list[TextRow] = []
    for mark in get_args(Mark):
        changed = [verdict for verdict in found.named(mark) if verdict.difference]
        rows += [row(mark)] if changed else []
        for verdict in changed:
            bounds = f"{verdict.interval.low:+.3g}", f"{verdict.interval.high:+.3g}"
            means = f"{verdict.base:.4g}", f"{verdict.new:.4g}"
            rows.append(row(f"  {verdict.metric.name}", str(verdict.frames), *means, *bounds))
    return TextTable("Metric", ("frames", "base", "new", *_BOUNDS), tuple(rows))


def _times(found: Comparison) -> TextTable:
    """Mean times, and the ratio of the new run's to the base's."""
    rows = []
    for verdict in (verdict for verdict in found.verdicts if verdict.metric.timed and verdict.base > 0):
        changes = verdict.difference, verdict.interval.low, verdict.interval.high
        ratios = (f"{1 + change / verdict.base:.2f}" for change in changes)
        rows.append(row(verdict.metric.name, f"{verdict.base:.2f}", f"{verdict.new:.2f}", *ratios))
    return TextTable("Latency", ("base ms", "new ms", "times", *_BOUNDS), tuple(rows))


def _verdict(found: Comparison) -> Iterator[str]:
    yield f"fields of the tables: {_states(found.columns)}"
    if found.messages:
        yield f"fields of messages with different bytes: {_states(found.messages)}"
    judged = [verdict for verdict in found.verdicts if verdict.judged]
    same = [verdict for verdict in judged if not verdict.difference]
    yield f"metrics: {len(judged)} judged, {len(same)} with equal means"
    changed = len(judged) - len(same)
    if changed:
        many = len(found.pairing.pairs) >= MANY_LOGS
        blocks = "whole logs as blocks" if many else "blocks of neighbouring frames"
        chance = f"chance alone marks about {changed * (1 - LEVEL):.2g} of {changed} metrics"
        yield f"intervals: {LEVEL:.0%} each, from {blocks}; {chance}"
    for mark in ("better", "worse"):
        yield from (f"{mark}: {_sentence(verdict)}" for verdict in found.named(mark))
    yield _conclusion(found)


def _states(agreements: Agreements) -> str:
    counts = Counter(agreement.state for agreement in agreements.values())
    return f"{counts['identical']} identical, {counts['within tolerance']} within tolerance, {counts['differs']} differ"


def _sentence(verdict: Verdict) -> str:
    low, high = verdict.interval.low, verdict.interval.high
    between = f" [{low:+.3g}, {high:+.3g}]" if math.isfinite(low) else ""
    values = f"{verdict.base:.4g} → {verdict.new:.4g}"
    return f"{verdict.metric.name} {values} ({verdict.difference:+.3g}{between})"


def _conclusion(found: Comparison) -> str:
    if found.regressions:
        return f"verdict: worse in {', '.join(found.regressions)}"
    if found.differences:
        better = [verdict.metric.name for verdict in found.named("better")]
        return f"verdict: different, nothing worse, better in {', '.join(better) or 'nothing'}"
    identical = all(agreement.state == "identical" for agreement in found.fields.values())
    return f"verdict: {'identical' if identical else 'within tolerance'}"
