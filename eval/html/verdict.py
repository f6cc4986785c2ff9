"""The top of the page: the verdict on one run, or on a run against its base, and the ranking of the worst frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from roadperc_stream.errors import TableError
from roadperc_stream.output.text_table import TextRow, TextTable
from roadperc_stream.schemas.columns import RATIO, UNITLESS
from roadperc_stream.system.text import number

from ..comparison.comparing import Comparison, compare_runs
from ..comparison.pairing import pair_runs
from ..comparison.verdicts import Finding, Mark, Place, Verdict
from ..options import Rules
from ..quantities import COVERED, LOST, NUMBERS, TRUTH, Quantity, listed, percent, rounded
from ..runs import Run
from ..sections import ranked_by
from ..statistics import Statistics
from ..summary import Summary, WorstFrame

BARS: Final = 9
"""Most bars of the verdict."""
_NO_EFFECT: Final = 0.01
"""Largest effect that is not drawn, as a multiple of the relevant effect."""
_CUT: Final = 10.0
"""Largest effect drawn, as a multiple of the relevant effect."""
_NAMES: Final = {quantity.column: quantity.name for quantity in NUMBERS}
_STAGES: Final = {
    "surface": ("surface_height_error_m", "surface_inlier_ratio"),
    "left": ("lane_left_error_m", "lane_left_second_difference_m"),
    "right": ("lane_right_error_m", "lane_right_second_difference_m"),
    "objects": ("object_distance_error_m", "detections_kept"),
    "stereo": ("stereo_epe_px", "stereo_valid_ratio"),
    "odometry": ("step_error_m", "odometry_inliers"),
}
"""By output in ``COVERED``: the column of its error, and the column shown without truth."""
_LANES: Final = {"left": "lane left", "right": "lane right"}


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


def stage_table(summaries: Sequence[Summary]) -> TextTable:
    """Coverage, and median, p95 and worst error of each stage; without truth those of a quality number."""
    quantities = {quantity.column: quantity for quantity in NUMBERS}
    rows, truth = [], any(error in s.statistics for s in summaries for error, _ in _STAGES.values())
    for output, columns in _STAGES.items():
        quantity = quantities[columns[0 if truth else 1]]
        cells = tuple(_stage_cells(summary, output, quantity) for summary in summaries)
        if any(cells):
            stage = _LANES.get(output, output)
            named = quantity.name.startswith(stage.removesuffix("s"))
            rows.append(TextRow(quantity.label if named else f"{stage}: {quantity.label}", cells))
    kind = "error" if truth else "value"
    notes = () if truth else ("No frame has truth: the numbers are the stages' own values, not errors.",)
    headers = ("frames %", f"{kind}, median", "p95", "largest")
    return TextTable("Stages", headers, tuple(rows), notes, tuple(summary.name for summary in summaries))


def _stage_cells(summary: Summary, output: str, quantity: Quantity) -> tuple[str, ...]:
    covered, found = summary.coverage(COVERED[output]), summary.statistics.get(quantity.column)
    if not covered and found is None:
        return ()
    return (percent(covered), *(_tail(found, quantity) if found else ("", "", "")))


def _tail(found: Statistics, quantity: Quantity) -> tuple[str, ...]:
    return tuple(rounded(value, quantity) for value in (found.abs_median, found.abs_p95, found.abs_most))


def single_sentence(summary: Summary) -> tuple[Mark, str]:
    """The mark of one run, and the stages whose p95 error is beyond its limit."""
    pairs = [(q, found) for q in TRUTH if q.limit is not None and (found := summary.statistics.get(q.column))]
    beyond = [q.name for q, found in pairs if _is_beyond(found, q)]
    if not pairs:
        return "unchanged", "No verdict, because no frame has truth"
    if beyond:
        return "worse", f"{len(beyond)} of {len(pairs)} errors have their p95 beyond the limit: {listed(beyond)}"
    return "better", f"The p95 of all {len(pairs)} errors is within its limit"


def _is_beyond(found: Statistics, quantity: Quantity) -> bool:
    limit = quantity.limit or 0.0
    return found.p5 < limit if quantity.better == "high" else found.abs_p95 > limit


def ranked_frames(groups: Sequence[Summary], most: int) -> list[Ranked]:
    """The worst frames across metrics, each once, by their size in relevant effects; only those above one."""
    found = [
        Ranked(frame, quantity, size(frame.value, quantity))
        for quantity in ranked_by(groups)
        for group in groups
        for frame in group.worst.get(quantity.column, ())
    ]
    largest: dict[tuple[str, int], Ranked] = {}
    for item in sorted((item for item in found if item.size > 1), key=lambda item: -item.size):
        largest.setdefault((item.frame.run, item.frame.frame), item)
    return list(largest.values())[:most]


def size(value: float, quantity: Quantity) -> float:
    """The distance from a perfect value in relevant effects; 0 if it is unknown."""
    if quantity == LOST:
        return 1.0 + value
    if quantity.better == "high" and quantity.unit != RATIO:
        return 0.0
    distance = 1.0 - value if quantity.better == "high" else abs(value)
    return distance / quantity.relevant if quantity.relevant else 0.0


def comparison_of(groups: Sequence[tuple[Sequence[Run], Sequence[Summary]]]) -> Comparison | None:
    """The second group of runs against the first; None unless there are two groups with a log in common."""
    if len(groups) != 2:
        return None
    base, new = ([_with_log(run, s) for run, s in zip(*group, strict=True)] for group in groups)
    if not {run.log_id for run in base} & {run.log_id for run in new}:
        return None
    try:
        return compare_runs(pair_runs(base, new, other_log=False), None, Rules())
    except TableError:  # frames without common stamps, for example
        return None


def _with_log(run: Run, summary: Summary) -> Run:
    return replace(run, log_id="+".join(summary.log_ids))


def sentence(found: Comparison) -> tuple[Mark, str]:
    """The mark of the comparison, and the verdict in a sentence."""
    worse, better = (len(found.groups(mark)) for mark in ("worse", "better"))
    total = len({verdict.metric.group for verdict in found.verdicts if verdict.judged})
    lacking = f"; {number(len(found.pairing.missing), 'log')} only in the base" if found.pairing.missing else ""
    counts = f"{worse} of {total} groups of metrics worse, {better} better{lacking}"
    mark: Mark = "worse" if found.regressions else "better" if better else "unchanged"
    return mark, f"New is {mark}: {counts}" if mark != "unchanged" else f"No relevant difference: {counts}"


def bars(found: Comparison) -> list[Bar]:
    """A bar for each group whose metrics changed: first the worse, then the better, then the unchanged ones."""
    marks: tuple[Mark, ...] = ("worse", "better", "unchanged")
    leading = [(mark, group) for mark in marks for group in found.groups(mark)]
    seen: dict[str, Bar] = {}
    for mark, group in leading:
        if mark != "unchanged" or group.verdicts[0].weight > _NO_EFFECT:
            seen.setdefault(group.name, _bar(group.verdicts[0], len(group.verdicts) - 1, len(found.pairing.pairs) > 1))
    return list(seen.values())[:BARS]


def place_text(found: Comparison, place: Place) -> str:
    """The metric of the worst place, its log if there are several, and both values."""
    metric = next(verdict.metric for verdict in found.named("worse") if verdict.place is place)
    where = f"{place.pair.name}, " if len(found.pairing.pairs) > 1 else ""
    values = f"{readable(place.base, metric.unit)} \N{RIGHTWARDS ARROW} {readable(place.new, metric.unit)}"
    return f"{where}frame {place.frame}: {metric_name(metric.name)} {values}"


def _bar(verdict: Verdict, others: int, several: bool) -> Bar:
    finding = (verdict.worst if verdict.mark == "worse" else None) or verdict.findings[0]
    unit, effect = verdict.metric.unit, verdict.metric.sign * (finding.new - finding.base)
    ends = (finding.interval.low, finding.interval.high) if finding.interval else ()
    places = sorted(_place(verdict.metric.sign * end, verdict) for end in ends)
    values = f"{readable(finding.base, unit)} \N{RIGHTWARDS ARROW} {readable(finding.new, unit)}"
    bounds = f", {readable(finding.new - finding.base, unit, sign='+')}"
    bounds += f" [{', '.join(readable(end, unit, sign='+') for end in ends)}]" if ends else ""
    left, right = sorted((50.0, _place(effect, verdict)))
    statistic = "" if finding.statistic == "mean" else f", {finding.statistic}"
    return Bar(
        f"{metric_name(verdict.metric.name)}{statistic}{_of_log(finding) if several else ''}",
        values + bounds,
        verdict.mark,
        left,
        max(right - left, 0.5),
        (places[0], places[1] - places[0]) if places else None,
        others,
    )


def _of_log(finding: Finding) -> str:
    return f" in {finding.log}" if finding.log else ""


def _place(effect: float, verdict: Verdict) -> float:
    """The place of an effect in percent of the bar's width; worse is right of the middle."""
    multiple = effect / (verdict.relevant or 1.0)
    return round(50 + 50 * min(max(multiple, -_CUT), _CUT) / _CUT, 2) if multiple == multiple else 50.0  # noqa: PLR0124


def metric_name(name: str) -> str:
    """The label of a metric such as ``lane_left_error_m`` or ``step_m.coverage``."""
    column, _, what = name.partition(".")
    label = _NAMES.get(column.replace("jitter", "second_difference"), column.replace("_", " "))
    return f"{label} {what}".strip()


def readable(value: float, unit: str, sign: str = "") -> str:
    """A value with its unit, without an exponent; ratios in percent."""
    if not math.isfinite(value):
        return "unknown"
    scaled, shown = (100 * value, " %") if unit == RATIO else (value, "" if unit in UNITLESS else f" {unit}")
    digits = min(max(2 - math.floor(math.log10(abs(scaled))), 0), 4) if scaled else 0
    return f"{scaled:{sign}z.{digits}f}{shown}"
