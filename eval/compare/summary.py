"""The verdict of a comparison in a few lines: what became worse and where, what became better."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Final

from roadperc_stream.schemas.columns import RATIO, UNITLESS
from roadperc_stream.system.text import number

from ..frame_commands import view_pair_command
from ..report_columns import QUALITY, SEEN, listed
from .agreement import Agreements, Value
from .comparing import Comparison
from .metrics import Metric
from .verdicts import CauseGroup, Mark, MarkedStatistic, Place, Statistic, Verdict

_MOST_GROUPS: Final[dict[Mark, int]] = {"worse": 3, "better": 2}
"""Groups of metrics with a line each; ``--full`` lists all."""
_MOST_SETTINGS: Final = 4
_MUCH: Final = 0.1
"""Smallest change of a share that is named though it is not judged."""
TEXT_SHOWN: Final = 48
"""Characters shown of a text value."""
_BY_USE: Final[tuple[Statistic, ...]] = ("mean", "worst frame", "worst log", "p95", "beyond limit", "spread")


def outcome(found: Comparison) -> str:
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
            changed = f"{both(change.first.base, change.first.new)} in frame {change.first.frame}"
            frames = number(change.differing, "frame")
            yield f"not judged: {column} {changed}, differs in {frames} by up to {change.largest:.3g}"


def _verdict(found: Comparison) -> str:
    result, changed = outcome(found), [*found.groups("worse"), *found.groups("better")]
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
    return f"{finding.metric.label}, {finding.statistic}{log} {values(finding, interval=interval)}"


def values(finding: MarkedStatistic, *, interval: bool = True) -> str:
    """A statistic in both runs with its unit, and its difference with the interval, if it has one."""
    scale, unit = shown_unit(finding.metric, finding.statistic)
    shown = both(finding.base * scale, finding.new * scale) + unit
    if finding.interval is None or not interval:
        return shown
    low, high = finding.interval.low * scale, finding.interval.high * scale
    between = f" [{low:+.3g}, {high:+.3g}]" if math.isfinite(low) else ""
    return f"{shown} ({(finding.new - finding.base) * scale:+.3g}{between})"


def shown_unit(metric: Metric, statistic: Statistic) -> tuple[float, str]:
    """Factor and name of the printed unit; shares are in percent."""
    if metric.share or statistic == "beyond limit":
        return 100.0, " %"
    return 1.0, "" if metric.unit in UNITLESS else f" {metric.unit}"


def both(base: Value, new: Value, digits: tuple[int, int] = (3, 6)) -> str:
    """Both values; with the second number of digits if the first does not show the difference."""
    short, long = ([_text(value, count) for value in (base, new)] for count in digits)
    return " → ".join(short if short[0] != short[1] else long)


def _text(value: Value, digits: int) -> str:
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    text = "none" if value is None else str(value)
    return text if len(text) <= TEXT_SHOWN else f"{text[:TEXT_SHOWN]}…"


def where(metric: Metric, place: Place) -> str:
    """The frame, its log, both values, and the command that shows it."""
    scale, unit = shown_unit(metric, "mean")
    values_there = both(place.base * scale, place.new * scale) + unit
    return f"frame {place.frame} of {place.pair.name}, {values_there}: {command(place)}"


def command(place: Place) -> str:
    """The command that shows the frame of both runs."""
    return view_pair_command(place.pair.base, place.pair.new, place.frame)


def _group(group: CauseGroup, mark: Mark, *, full: bool) -> Iterator[str]:
    """The leading metric with the frame that became worse by most; with ``full`` a line for each finding."""
    first, *others = group.verdicts
    lead, mean = _lead(first), first.findings[0]
    also = f" (and {number(len(others), 'other metric')})" if others else ""
    yield f"{mark}, {group.name}{also}: {_sentence(lead)}{'' if lead is mean else f'; mean {values(mean)}'}"
    place = lead.place or first.place
    if mark == "worse" and place is not None:
        yield f"  {where(first.metric, place)}"
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
