"""Shows a comparison: the verdict in a few lines, on request tables and fields, and files for other programs."""

import math
from collections import Counter
from collections.abc import Iterator
from itertools import groupby
from typing import Any, Final, get_args

from roadperc_stream.output.text_table import Row, Table
from roadperc_stream.schemas.columns import RATIO, UNITLESS
from roadperc_stream.system.text import listed, number

from ..configurations import UNKNOWN, short_digest
from ..frame_commands import view_pair_command
from ..report_columns import QUALITY, SEEN
from ..results import Case, Outcome, Results
from ..runs import Run
from .bootstrap import LEVEL, MANY_LOGS
from .comparison import CauseGroup, Comparison
from .fields import Agreement, Agreements, Value
from .metrics import Metric
from .verdicts import Mark, MarkedStatistic, Place, Statistic, Verdict

_MOST_GROUPS: Final[dict[Mark, int]] = {"worse": 3, "better": 2}
"""Groups of metrics with a line each; ``--full`` lists all."""
_MOST_SETTINGS: Final = 4
_MOST_FIELDS: Final = 10
"""Differing fields shown without ``--exact``."""
_MUCH: Final = 0.1
"""Smallest change of a share that is named though it is not judged."""
_DIGITS: Final = (3, 6)
"""Digits of two values, and those if the first do not show the difference."""
_TEXT_SHOWN: Final = 48
"""Characters shown of a text value."""
_BY_USE: Final[tuple[Statistic, ...]] = ("mean", "worst frame", "worst log", "p95", "beyond limit", "spread")
_BOUNDS: Final = f"{LEVEL:.0%} from", "to"


def for_people(found: Comparison, *, full: bool, all_fields: bool) -> Results:
    """The verdict in a few lines; with ``full`` also the tables of metrics and times, and fields that differ.

    With ``all_fields`` every field that differs, else the first ones.
    """
    title, head, fields = "Comparison", list(summary(found, full=full)), _fields(found, all_fields=all_fields)
    if not full:
        return Results("compare", title, head, tail=list(fields) if all_fields else ())
    if len(found.pairing.pairs) == 1:
        (pair,) = found.pairing.pairs
        head += ["", _identity("base", pair.base), _identity("new", pair.new)]
    return Results("compare", title, head, [_metrics_table(found), _times(found)], list(fields))


def _identity(side: str, run: Run) -> str:
    config, version = short_digest(run.config_digest), run.version or UNKNOWN
    return f"{side} {run.source_name}: log {run.log_id}, configuration {config}, version {version}"


def for_programs(found: Comparison, *, exact: bool) -> Results:
    """The verdict, the metrics and all figures for files; with ``exact`` also each field as a JUnit case."""
    first, *lines = summary(found)
    title, tables, cases = f"Comparison: {first}", [_metrics_table(found)], list(_cases(found, exact=exact))
    return Results("compare", title, lines, tables, values=_as_json(found), cases=cases)


def _as_json(found: Comparison) -> dict[str, Any]:
    """The verdict, counts, changed settings, every judged metric with its statistics, and counts of fields."""
    changed = {line for lines in found.changes for line in lines[1:]}
    states = Counter(agreement.state for agreement in found.fields.values())
    return {
        "verdict": _outcome(found),
        "counts": {mark: len(found.named(mark)) for mark in get_args(Mark)},
        "frames": found.frames,
        "logs": len(found.pairing.pairs),
        "missing_logs": len(found.pairing.missing),
        "settings": dict(line.split(" ", 1) for line in sorted(changed)),
        "metrics": {verdict.metric.name: _metric(verdict) for verdict in found.verdicts if verdict.judged},
        "fields": {state.replace(" ", "_"): states[state] for state in ("identical", "within tolerance", "differs")},
    }


def _metric(verdict: Verdict) -> dict[str, Any]:
    metric = verdict.metric
    statistics = {finding.statistic.replace(" ", "_"): _statistic(finding) for finding in verdict.findings}
    facts = {"mark": verdict.mark, "unit": metric.unit, "group": metric.group, "frames": verdict.frames}
    place = {"place": _place(verdict.place)} if verdict.place and verdict.mark == "worse" else {}
    return {**facts, "relevant": float(f"{verdict.relevant:.6g}"), **statistics, **place}


def _statistic(finding: MarkedStatistic) -> dict[str, Any]:
    known = {"base": finding.base, "new": finding.new, "difference": finding.new - finding.base, "mark": finding.mark}
    interval = vars(finding.interval) if finding.interval else {}
    return {**known, **interval, **({"log": finding.log} if finding.log else {})}


def _place(place: Place) -> dict[str, Any]:
    at = {"log": place.pair.name, "frame": place.frame, "stamp_ns": place.stamp_ns}
    return {**at, "base": place.base, "new": place.new, "command": _command(place)}


def _cases(found: Comparison, *, exact: bool) -> Iterator[Case]:
    """A case for each statistic of a judged metric, for each missing run, and with ``exact`` for each field."""
    pairs = found.pairing.pairs
    every = pairs[0].name if len(pairs) == 1 else "all logs"
    for finding in (finding for verdict in found.verdicts if verdict.judged for finding in verdict.findings):
        worse, text = finding.mark == "worse", f"{finding.mark}: {_values(finding)}"
        text += f"\n{_where(finding.place)}" if worse and finding.place else ""
        result: Outcome = "failed" if worse else "passed"
        yield Case(finding.log or every, f"{finding.metric.name} {finding.statistic}", result, text)
    yield from (Case(run.name, "run", "failed", "missing in the new run") for run in found.pairing.missing)
    for name, agreement in found.fields.items() if exact else ():
        first = agreement.first
        text = f"first in frame {first.frame}: {first.base} → {first.new}" if first else agreement.state
        yield Case(first.run if first else every, f"{name} equal", "failed" if first else "passed", text)


def _outcome(found: Comparison) -> str:
    """``worse``, ``better`` or ``no relevant difference``."""
    if found.regressions:
        return "worse"
    return "better" if found.named("better") else "no relevant difference"


def summary(found: Comparison, *, full: bool = False) -> Iterator[str]:
    """The verdict, the settings that differ, and a line for each cause that became worse or better; then counts.

    With ``full`` every metric and every finding has a line.
    """
    yield _verdict(found)
    yield from _settings(found, full=full)
    yield from _compared(found)
    for mark, most in _MOST_GROUPS.items():
        groups = found.groups(mark)
        shown = groups if full else groups[:most]
        for group in shown:
            yield from _group(group, mark, full=full)
        if len(shown) < len(groups):
            yield f"{mark}: {listed([group.name for group in groups[most:]])}; pass --full for details"
    yield f"unchanged: {number(len(found.named('unchanged')), 'metric')}"
    yield from _unjudged(found)
    yield f"fields of the tables: {_states(found.columns)}"
    if found.messages:
        yield f"fields of messages with different bytes: {_states(found.messages)}"


def _unjudged(found: Comparison) -> Iterator[str]:
    """A line for each share that changed much and is neither better nor worse if high."""
    judged = {quantity.column for quantity in QUALITY}
    for column in (quantity.column for quantity in SEEN if quantity.unit == RATIO and quantity.column not in judged):
        change = found.columns.get(column)
        if change is not None and change.first is not None and change.largest >= _MUCH:
            changed = f"{both_values(change.first.base, change.first.new)} in frame {change.first.frame}"
            frames = number(change.differing, "frame")
            yield f"not judged: {column} {changed}, differs in {frames} by up to {change.largest:.3g}"


def _verdict(found: Comparison) -> str:
    result, changed = _outcome(found), [*found.groups("worse"), *found.groups("better")]
    counts = ", ".join(f"{len(found.named(mark))} {mark}" for mark in _MOST_GROUPS)
    metrics = f"{number(sum(verdict.judged for verdict in found.verdicts), 'metric')} judged, {counts}"
    if found.pairing.missing:
        return f"{result}: no new run of {listed([run.name for run in found.pairing.missing])}; {metrics}"
    return f"{result}: {f'{_sentence(_lead(changed[0].verdicts[0]), interval=False)}; ' if changed else ''}{metrics}"


def _lead(verdict: Verdict) -> MarkedStatistic:
    """The finding that explains the mark: the mean, else the one that is easiest to look at."""
    found = [finding for finding in verdict.findings if finding.mark == verdict.mark]
    return min(found, key=lambda finding: _BY_USE.index(finding.statistic), default=verdict.findings[0])


def _sentence(finding: MarkedStatistic, *, interval: bool = True) -> str:
    log = f" of {finding.log}" if finding.log else ""
    return f"{finding.metric.label}, {finding.statistic}{log} {_values(finding, interval=interval)}"


def _values(finding: MarkedStatistic, *, interval: bool = True) -> str:
    """A statistic in both runs with its unit, and its difference with the interval, if it has one."""
    scale, unit = _shown_unit(finding.metric, finding.statistic)
    shown = both_values(finding.base * scale, finding.new * scale) + unit
    if finding.interval is None or not interval:
        return shown
    low, high = finding.interval.low * scale, finding.interval.high * scale
    between = f" [{low:+.3g}, {high:+.3g}]" if math.isfinite(low) else ""
    return f"{shown} ({(finding.new - finding.base) * scale:+.3g}{between})"


def _shown_unit(metric: Metric, statistic: Statistic) -> tuple[float, str]:
    """Factor and name of the printed unit; shares are in percent."""
    if metric.share or statistic == "beyond limit":
        return 100.0, " %"
    return 1.0, "" if metric.unit in UNITLESS else f" {metric.unit}"


def both_values(base: Value, new: Value, digits: tuple[int, int] = _DIGITS) -> str:
    """Both values with an arrow."""
    return " → ".join(_told_apart(base, new, digits))


def _told_apart(base: Value, new: Value, digits: tuple[int, int]) -> tuple[str, str]:
    """Both values; with the second number of digits if the first does not show the difference."""
    short, long = ((_text(base, count), _text(new, count)) for count in digits)
    return short if short[0] != short[1] else long


def _text(value: Value, digits: int) -> str:
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    text = "none" if value is None else str(value)
    return text if len(text) <= _TEXT_SHOWN else f"{text[:_TEXT_SHOWN]}…"


def _where(place: Place) -> str:
    """The frame, its log, both values, and the command that shows it."""
    base, new, unit = values_at(place)
    return f"frame {place.frame} of {place.pair.name}, {base} → {new}{unit}: {_command(place)}"


def values_at(place: Place) -> tuple[str, str, str]:
    """The metric of base and new in a frame, and its unit."""
    scale, unit = _shown_unit(place.metric, "mean")
    return *_told_apart(place.base * scale, place.new * scale, _DIGITS), unit


def _command(place: Place) -> str:
    """The command that shows the frame of both runs."""
    return view_pair_command(place.pair.base, place.pair.new, place.frame)


def _group(group: CauseGroup, mark: Mark, *, full: bool) -> Iterator[str]:
    """The leading metric with the frame that became worse by most; with ``full`` a line for each finding."""
    first, *others = group.verdicts
    lead, mean = _lead(first), first.findings[0]
    also = f" (and {number(len(others), 'other metric')})" if others else ""
    yield f"{mark}, {group.name}{also}: {_sentence(lead)}{'' if lead is mean else f'; mean {_values(mean)}'}"
    place = lead.place or first.place
    if mark == "worse" and place is not None:
        yield f"  {_where(place)}"
    if full:
        found = (finding for verdict in group.verdicts for finding in verdict.findings if finding.mark == mark)
        yield from (f"  {_sentence(finding)}" for finding in found)


def _settings(found: Comparison, *, full: bool) -> Iterator[str]:
    """The settings that differ, with both values; pairs with the same differences are listed together."""
    names: dict[tuple[str, ...], list[str]] = {}
    for pair, changed in zip(found.pairing.pairs, found.changes, strict=True):
        if changed:
            names.setdefault(changed, []).append(pair.name)
    lists = list(names.items())
    for (heading, *lines), runs in lists if full else lists[:2]:
        among = "" if len(runs) == len(found.pairing.pairs) else f" in {listed(runs)}"
        yield f"settings that differ{among}: {heading or listed(lines, len(lines) if full else _MOST_SETTINGS)}"
    if len(lists) > 2 and not full:
        yield f"settings that differ in other runs: {len(lists) - 2} more lists; pass --full"


def _compared(found: Comparison) -> Iterator[str]:
    """The number of compared frames, and what only one side has."""
    pairs = found.pairing.pairs
    yield f"{number(found.frames, 'frame')} compared" + (f" in {len(pairs)} pairs of runs" if len(pairs) > 1 else "")
    apart = [(pair.name, part) for pair, part in zip(pairs, found.overlaps, strict=True) if sum(part[1:])]
    if apart:
        ours, theirs = (sum(part[side] for _, part in apart) for side in (1, 2))
        names = listed([name for name, _ in apart])
        yield f"frames only in the base run: {ours}, only in the new run: {theirs} (in {names})"
    for side, runs in (("base", found.pairing.missing), ("new", found.pairing.added)):
        if runs:
            yield f"only in {side}: {listed([f'{run.name} (log {run.log_id})' for run in runs])}"


def _states(agreements: Agreements) -> str:
    counts = Counter(agreement.state for agreement in agreements.values())
    return f"{counts['identical']} identical, {counts['within tolerance']} within tolerance, {counts['differs']} differ"


def _fields(found: Comparison, *, all_fields: bool) -> Iterator[str]:
    """The first difference of each field that differs, below its frame, in the order of time."""
    first = [(difference, agreement) for agreement in found.fields.values() if (difference := agreement.first)]
    differing = sorted(first, key=lambda item: item[0].at)
    shown = differing if all_fields else differing[:_MOST_FIELDS]
    are_several = len(found.pairing.pairs) > 1
    if are_several and shown:
        yield from ("", "first difference of each field, and its number of frames in all pairs")
    for (run, stamp_ns, frame), group in groupby(shown, key=lambda item: item[0].at):
        several = f"{run}: " if are_several else ""
        yield from ("", f"{several}frame {frame}, stamp {stamp_ns}")
        for difference, agreement in group:
            values = both_values(difference.base, difference.new, (6, 17))
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


def _metrics_table(found: Comparison) -> Table:
    """The metrics that changed, by mark: means of both runs, and the interval of the difference."""
    rows: list[Row] = []
    for mark in get_args(Mark):
        changed = [verdict for verdict in found.named(mark) if verdict.difference]
        rows += [(mark,)] if changed else []
        for verdict in changed:
            bounds = f"{verdict.interval.low:+.3g}", f"{verdict.interval.high:+.3g}"
            means = f"{verdict.base:.4g}", f"{verdict.new:.4g}"
            rows.append((f"  {verdict.metric.name}", str(verdict.frames), *means, *bounds))
    blocks = "whole logs" if len(found.pairing.pairs) >= MANY_LOGS else "blocks of neighbouring frames"
    notes = (f"intervals: {LEVEL:.0%} for all groups of metrics together, from resampled {blocks}",) if rows else ()
    return Table("Metric", ("frames", "base", "new", *_BOUNDS), tuple(rows), notes)


def _times(found: Comparison) -> Table:
    """Mean times, and the ratio of the new run's to the base's."""
    rows = []
    for verdict in (verdict for verdict in found.verdicts if verdict.metric.timed and verdict.base > 0):
        changes = verdict.difference, verdict.interval.low, verdict.interval.high
        ratios = (f"{1 + change / verdict.base:.2f}" for change in changes)
        rows.append((verdict.metric.name, f"{verdict.base:.2f}", f"{verdict.new:.2f}", *ratios))
    return Table("Latency", ("base ms", "new ms", "times", *_BOUNDS), tuple(rows))
