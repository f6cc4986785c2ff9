"""Writes a criteria file from reference runs: their statistics with a margin as limits."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from roadperc_stream.errors import TableError
from roadperc_stream.schemas.columns import UNITLESS
from roadperc_stream.system.files import require_free, write_whole
from roadperc_stream.system.text import listed, number

from ..compare.metrics import COVERAGE_RELEVANT, METRICS, Metric
from ..criteria import Criterion
from ..report_columns import percent
from ..runs import Run
from .judging import Result, judge

_MARGIN: Final = 0.2
_DIGITS: Final = 3
_HEAD: Final = """\
# Limits for roadperc-check, from {frames} of {names}.
# Each limit is the statistic of these runs plus {margin:.0%} and the smallest relevant effect of the metric. Where high
# is better, the margin applies to the distance from 1. The comments show the statistics of the runs.
# Change any number. docs/checks.md explains the keys.

criterion = [
{findings}"""


def write_criteria(path: Path, runs: Sequence[Run], *, force: bool) -> int:
    """Write limits for the mean, p95, maximum and coverage of each metric with values; returns the number of metrics.

    If high is better, p5 and the minimum replace p95 and the maximum. Shares of frames, such as coverage, get a limit
    for the mean; times get none, because they depend on the machine.

    Raises:
        TargetError: the file exists and ``force`` is false, or it cannot be written.
        TableError: the runs have no values, or cannot be read.
    """
    require_free(path, force=force, suffix=".toml")
    lines = list(_lines(runs, path))
    if not lines:
        raise TableError(f"{runs[0].source_name}: no metric has a value, so there is nothing to limit")
    names = listed([run.name for run in runs]) if len(runs) > 1 else runs[0].name
    frames = number(sum(run.frames for run in runs), "frame")
    known = [len(run.findings) for run in runs if run.findings is not None]
    findings = f'  {{ statistic = "findings", most = {max(known)} }},\n' if known else ""
    head = _HEAD.format(frames=frames, names=names, margin=_MARGIN, findings=findings)
    write_whole(path, head + "".join(lines) + "]\n", force=force)
    return len(lines)


def _lines(runs: Sequence[Run], path: Path) -> Iterator[str]:
    """The lines of each metric with values."""
    metrics = [metric for metric in METRICS if not metric.timed]
    asked = [
        Criterion.model_validate({"metric": metric.name, "statistic": name, "least": 0})
        for metric in metrics
        for name in _statistics(metric)
    ]
    found: dict[str, list[Result]] = {}
    for result in judge(asked, runs, path):
        found.setdefault(result.criterion.subject, []).append(result)
    for metric in metrics:
        first = found[metric.name][0]
        covered = metric.name.removesuffix(".coverage")
        limited_with_errors = covered != metric.name and covered in found
        if first.value is not None and not limited_with_errors and not (metric.share and first.value == 0):
            yield _of_metric(metric, found[metric.name])


def _statistics(metric: Metric) -> tuple[str, ...]:
    if metric.share or metric.whole:
        return ("mean",)
    return ("mean", "p5", "min") if metric.higher_is_better else ("mean", "p95", "max")


def _of_metric(metric: Metric, results: Sequence[Result]) -> str:
    """A comment with the statistics, and a line per criterion; the first one limits the coverage as well."""
    unit = "" if metric.unit in UNITLESS else f" {metric.unit}"
    values = ", ".join(f"{result.criterion.statistic} {result.value:.4g}" for result in results)
    coverage = "" if metric.share else f"; coverage {percent(results[0].coverage)} %"
    lines = [f"  # {metric.name}: {values}{unit}{coverage}"]
    for place, result in enumerate(results):
        keys = f'metric = "{metric.name}", statistic = "{result.criterion.statistic}", {_bound(metric, result.value)}'
        if place == 0 and not metric.share:
            keys += f", least_coverage = {_least(results[0].coverage, COVERAGE_RELEVANT):g}"
        lines.append(f"  {{ {keys} }},")
    return "\n".join(lines) + "\n"


def _bound(metric: Metric, value: float | None) -> str:
    assert value is not None
    if metric.higher_is_better:
        return f"least = {_least(value, metric.relevant):g}"
    return f"most = {_rounded_up(value * (1 + _MARGIN) + metric.relevant):g}"


def _least(share: float, relevant: float) -> float:
    """A limit below a share of at most 1: the distance from 1 grows by the margin."""
    return max(1 - _rounded_up((1 - share) * (1 + _MARGIN) + relevant), 0.0)


def _rounded_up(value: float) -> float:
    """A value rounded up to ``_DIGITS`` digits."""
    if value == 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return float(f"{math.ceil(value / step) * step:.{_DIGITS}g}")
