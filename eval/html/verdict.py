"""The top of the page: the verdict on one run, or on a run against its base, and the ranking of the worst frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roadperc_stream.schemas.columns import RATIO, UNITLESS
from roadperc_stream.system.text import listed, number

from ..compare.comparison import Comparison, compare_runs
from ..compare.pairing import pair_runs
from ..compare.verdicts import Mark, Place, Verdict
from ..options import Rules
from ..report.full_tables import ranked_by
from ..report.stages import judged_stages, stage_figures, worst_of
from ..report.summaries import Summary, WorstFrame
from ..report_columns import LOST, Quantity, judged_errors
from ..runs import Run

BARS: Final = 9
"""Most bars of the verdict."""
_NO_EFFECT: Final = 0.01
"""Largest effect that is not drawn, as a multiple of the relevant effect."""
_CUT: Final = 10.0
"""Largest effect drawn, as a multiple of the relevant effect."""


@dataclass(frozen=True)
class Bar:
    """A change of a group: texts, and the places of its ends and of its interval in percent of the bar's width."""

    name: str
    change: str
    mark: Mark
    start: float
    width: float
    whisker: tuple[float, float] | None
    others: int


@dataclass(frozen=True)
class Ranked:
    """A frame, the quantity in which it is bad, and its size as a multiple of the relevant effect."""

    frame: WorstFrame
    quantity: Quantity
    size: float


def single_sentence(summary: Summary) -> tuple[Mark, str]:
    """The mark of one run, and the stages whose p95 error is beyond its limit."""
    judging = [q for q in judged_errors(summary.statistics) if q.limit is not None]
    known = [(q, summary.statistics[q.column]) for q in judging]
    beyond = [q.name for q, s in known if (s.p5 < (q.limit or 0) if q.better == "high" else s.abs_p95 > (q.limit or 0))]
    if not known:
        return "unchanged", "No verdict, because no frame has truth or an error by hindsight"
    if beyond:
        return "worse", f"{len(beyond)} of {number(len(known), 'error')} with p95 beyond the limit: {listed(beyond)}"
    return "better", f"{number(len(known), 'error')} with p95 within the limit"


def ranked_frames(groups: Sequence[Summary], most: int) -> list[Ranked]:
    """The worst frames across metrics, at different moments, by their size in relevant effects; only those above one.

    The first one is that of the report, the largest multiple of a limit, if a stage has one.
    """
    found = [
        Ranked(frame, quantity, size(frame.value, quantity))
        for quantity in ranked_by(groups)
        for group in groups
        for frame in group.worst.get(quantity.column, ())
    ]
    judged = judged_stages(groups)
    worst = worst_of(figure for group in groups for figure in stage_figures(group, judged))
    leading = [Ranked(worst.at, worst.quantity, size(worst.at.value, worst.quantity))] if worst and worst.at else []
    largest: list[Ranked] = []
    for item in (*leading, *sorted((item for item in found if item.size > 1), key=lambda item: -item.size)):
        if not any(item.frame.is_beside(other.frame) for other in largest):
            largest.append(item)
    return largest[:most]


def size(value: float, quantity: Quantity) -> float:
    """The distance from a perfect value in relevant effects; 0 if it is unknown."""
    if quantity == LOST:
        return 1.0 + value
    if quantity.better == "high" and quantity.unit != RATIO:
        return 0.0
    distance = 1.0 - value if quantity.better == "high" else abs(value)
    return distance / quantity.relevant if quantity.relevant else 0.0


def comparison_of(groups: Sequence[tuple[Sequence[Run], Sequence[Summary]]]) -> Comparison | None:
    """The second group of runs against the first; None unless there are two groups with a log in common.

    Raises:
        TableError: the runs share no stamp.
    """
    if len(groups) != 2:
        return None
    base, new = (
        [replace(run, log_id="+".join(summary.log_ids)) for run, summary in zip(*group, strict=True)]
        for group in groups
    )
    if not {run.log_id for run in base} & {run.log_id for run in new}:
        return None
    return compare_runs(pair_runs(base, new, other_log=False), None, Rules())


def sentence(found: Comparison) -> tuple[Mark, str]:
    """The mark of the comparison, and the verdict in a sentence."""
    worse, better = (len(found.groups(mark)) for mark in ("worse", "better"))
    total = len({verdict.metric.group for verdict in found.verdicts if verdict.judged})
    counts = f"{worse} of {total} groups of metrics worse, {better} better"
    mark: Mark = "worse" if found.regressions else "better" if better else "unchanged"
    if found.pairing.missing:
        return mark, f"New has no run of {number(len(found.pairing.missing), 'log')}; {counts}"
    return mark, f"New is {mark}: {counts}" if mark != "unchanged" else f"No relevant difference: {counts}"


def bars(found: Comparison) -> list[Bar]:
    """A bar for each group whose metrics changed: first the worse, then the better, then the unchanged ones."""
    seen: dict[str, Bar] = {}
    marks: tuple[Mark, ...] = ("worse", "better", "unchanged")
    for group in (group for mark in marks for group in found.groups(mark)):
        if group.verdicts[0].weight > _NO_EFFECT:
            seen.setdefault(group.name, _bar(group.verdicts[0], len(group.verdicts) - 1, len(found.pairing.pairs) > 1))
    return list(seen.values())[:BARS]


def place_text(found: Comparison, place: Place) -> str:
    """The metric of the worst place, its log if there are several, and both values."""
    metric = place.metric
    where = f"{place.pair.name}, " if len(found.pairing.pairs) > 1 else ""
    return f"{where}frame {place.frame}: {metric.label} {arrow(place.base, place.new, metric.unit)}"


def _bar(verdict: Verdict, others: int, several: bool) -> Bar:
    found = (verdict.worst if verdict.mark == "worse" else None) or verdict.findings[0]
    unit, sign = verdict.metric.unit, verdict.metric.sign
    ends = (found.interval.low, found.interval.high) if found.interval else ()
    bounds = f" [{', '.join(readable(end, unit, '+') for end in ends)}]" if ends else ""
    change = f"{arrow(found.base, found.new, unit)}, {readable(found.new - found.base, unit, '+')}{bounds}"
    left, right = sorted((50.0, _place(sign * (found.new - found.base), verdict)))
    places = sorted(_place(sign * end, verdict) for end in ends)
    statistic = "" if found.statistic == "mean" else f", {found.statistic}"
    name = f"{verdict.metric.label}{statistic}{f' in {found.log}' if several and found.log else ''}"
    whisker = (places[0], places[1] - places[0]) if places else None
    return Bar(name, change, verdict.mark, left, max(right - left, 0.5), whisker, others)


def _place(effect: float, verdict: Verdict) -> float:
    """The place of an effect in percent of the bar's width; worse is right of the middle."""
    multiple = np.nan_to_num(effect / (verdict.relevant or 1.0))
    return float(round(50 + 50 * np.clip(multiple / _CUT, -1, 1), 2))


def arrow(base: float, new: float, unit: str) -> str:
    """Both values."""
    return f"{readable(base, unit)} \N{RIGHTWARDS ARROW} {readable(new, unit)}"


def readable(value: float, unit: str, sign: str = "") -> str:
    """A value with its unit, without an exponent; ratios in percent."""
    if not math.isfinite(value):
        return "unknown"
    scaled, shown = (100 * value, " %") if unit == RATIO else (value, "" if unit in UNITLESS else f" {unit}")
    digits = min(max(2 - math.floor(math.log10(abs(scaled))), 0), 4) if scaled else 0
    return f"{scaled:{sign}z.{digits}f}{shown}"
