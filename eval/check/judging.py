"""Judges criteria over runs: the statistic of each, its coverage, and the worst frame of those that fail."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.errors import ConfigError
from roadperc_stream.geometry import Float
from roadperc_stream.schemas.columns import TIME_COLUMNS, UNITLESS, FrameMetrics, columns_of, errors
from roadperc_stream.schemas.columns.hindsight import FrameHindsight
from roadperc_stream.system.text import number as number_of
from roadperc_stream.system.time import NS_PER_S

from ..criteria import BY_NAME, Criterion
from ..expressions import on_empty_rows, parsed, similar
from ..findings import finding_lines, findings_of
from ..frame_commands import view_command
from ..objects.figures import frame_values, parts_of
from ..report_columns import TRUTH_OF, percent
from ..results import Outcome
from ..runs import Run, reading, written_columns
from ..scan import SEGMENT, before, rows_of, scan

_QUANTILES: Final = {"median": 0.5, "p1": 0.01, "p5": 0.05, "p95": 0.95, "p99": 0.99, "min": 0.0, "max": 1.0}
_TRUTHS: Final = (
    (errors.SurfaceErrorColumns,),
    (errors.LaneErrorColumns, errors.LaneScoreColumns, errors.TrueLaneColumns),
    (errors.ObjectErrorColumns, errors.TrueImpactColumns),
    (errors.StereoErrorColumns,),
    (errors.OdometryErrorColumns, errors.TruePoseColumns),
)
"""Groups of columns that need the same truth: a value in any of them shows that a log has this truth."""
_OF_TRUTH: Final = tuple([name for group in groups for name in columns_of(group)] for groups in _TRUTHS)
_S_PER_MINUTE: Final = 60
ALL: Final = "all logs"


@dataclass(frozen=True)
class WorstPlace:
    """The worst frame of a result; ``value`` is None if the frame has no value."""

    log: str
    frame: int
    value: float | None
    command: str


@dataclass(frozen=True)
class Result:
    """The result of a criterion over one log, or over ``ALL`` logs.

    ``value`` is the statistic, None without values. ``coverage`` is the share of the ``frames`` with a value; frames
    are those that fulfil the filter. ``reason`` explains every outcome except passed.
    """

    criterion: Criterion
    log: str
    outcome: Outcome
    frames: int
    value: float | None = None
    coverage: float = 0.0
    reason: str = ""
    worst: WorstPlace | None = None

    @property
    def text(self) -> str:
        """Value, bound and coverage in one line, or the reason why it is skipped."""
        if self.outcome not in ("passed", "failed"):
            return self.reason
        unit = unit_of(self.criterion)
        value = "no value" if self.value is None else f"{self.value:.4g}{unit}"
        if self.criterion.statistic == "findings":
            return f"{value}, {self.criterion.bound}{f': {self.reason}' if self.reason else ''}"
        covered = "" if self.criterion.statistic == "rate" else f"; coverage {percent(self.coverage)} %"
        least = self.criterion.least_coverage
        return f"{value}, {self.criterion.bound}{unit}{covered}{f', at least {percent(least)} %' if least else ''}"


@dataclass(frozen=True)
class _Part:
    """The frames of a run that fulfil a criterion's filter: ``frame`` and ``value``, and their time in minutes."""

    run: Run
    rows: pl.DataFrame
    minutes: float
    skipped: str = ""
    """Why it does not count."""


def judge(criteria: Sequence[Criterion], runs: Sequence[Run], source: Path) -> list[Result]:
    """A result for each criterion, or for each log with ``per_log``, in the order of the file.

    Raises:
        ConfigError: a criterion of the file ``source`` names an unknown column, or its SQL does not fit.
        TableError: a table cannot be read.
    """
    schema = pl.Schema(
        {**written_columns(), **{k: v for run in runs for k, v in _frames_of(run).collect_schema().items()}}
    )
    for criterion in criteria:
        _require_fit(criterion, schema, f"{source}: criterion {criterion.title!r}")
    of_frames = [criterion for criterion in criteria if criterion.statistic != "findings"]
    by_run = [_measured(of_frames, run, schema, len(runs)) for run in runs]
    parts_by_criterion = zip(*by_run, strict=True)
    results: list[Result] = []
    for criterion in criteria:
        parts = [None] * len(runs) if criterion.statistic == "findings" else next(parts_by_criterion)
        pairs = list(zip(runs, parts, strict=True))
        for group in [[pair] for pair in pairs] if criterion.per_log else [pairs]:
            log, of_group = group[0][0].name if len(group) == 1 else ALL, [part for _, part in group if part]
            found = _judged(criterion, of_group, log) if of_group else _found(criterion, [run for run, _ in group], log)
            results.append(found)
    return results


def _found(criterion: Criterion, runs: Sequence[Run], log: str) -> Result:
    """The result of a criterion on the findings that the tables of runs record."""
    frames, known = sum(run.frames for run in runs), [run for run in runs if run.findings is not None]
    if not known:
        return Result(criterion, log, "skipped", frames, reason="the tables do not record findings")
    value = float(max(len(run.findings or ()) for run in known))
    outcome: Outcome = "passed" if _within_bound(criterion, value) else "failed"
    return Result(criterion, log, outcome, frames, value, 1.0, "; ".join(finding_lines(findings_of(known))))


def unit_of(criterion: Criterion) -> str:
    """The unit of the statistic with a space before it; empty if it has none."""
    if criterion.statistic == "rate":
        return " per minute"
    units = {name: column.unit for row in (FrameMetrics, FrameHindsight) for name, column in columns_of(row).items()}
    known = units | dict.fromkeys(TIME_COLUMNS, "ms")
    unit = BY_NAME[criterion.metric].unit if criterion.metric else known.get(criterion.column or "", "")
    return "" if unit in UNITLESS or criterion.statistic == "share" else f" {unit}"


def _frames_of(run: Run) -> pl.LazyFrame:
    """The columns of a report, derived ones included, and the other columns of a run's table."""
    report = scan(run)
    names = report.collect_schema().names()
    return pl.concat([report, rows_of(run).select(pl.exclude(names))], how="horizontal")


def _require_fit(criterion: Criterion, schema: pl.Schema, where: str) -> None:
    """Check that the columns of a criterion exist, that its value is a number, and that its SQL is a condition."""
    for key, found, expected in (
        ("filter", _sql(criterion.filter), "a condition"),
        ("event", _sql(criterion.event), "a condition"),
        ("column", pl.col(criterion.column or "frame"), "numbers"),
    ):
        if wrong := [name for name in found.meta.root_names() if name not in schema]:
            text = str(getattr(criterion, key))
            raise ConfigError(f"{where}: {key}: no column {wrong[0]}; {similar(text, wrong[0], schema)}")
        try:
            kind = on_empty_rows(found, schema).dtype
        except ValueError as error:
            raise ConfigError(f"{where}: {key}: {error}") from error
        if kind != pl.Boolean and not (expected == "numbers" and kind.is_numeric()):
            raise ConfigError(f"{where}: {key}: is of type {kind}, expected {expected}")


def _sql(text: str | None) -> pl.Expr:
    """A condition that the reader of the file has parsed; true without one."""
    return pl.lit(value=True) if text is None else parsed(text)


def _value(criterion: Criterion) -> pl.Expr:
    """The value of each frame; for a rate whether the event begins in it."""
    if criterion.statistic == "rate":
        event = _sql(criterion.event).fill_null(value=False)
        return (event & ~before(event, 1).fill_null(value=False)).cast(pl.Float64)
    metric = BY_NAME.get(criterion.metric or "")
    number = (metric.value if metric else pl.col(criterion.column or "")).cast(pl.Float64)
    judged = number.abs() if metric and not metric.higher_is_better else number
    return pl.when(judged.is_finite()).then(judged)


def _measured(criteria: Sequence[Criterion], run: Run, schema: pl.Schema, logs: int) -> list[_Part]:
    """The part of one run, of ``logs`` in all, in each criterion."""
    whole: dict[str | None, dict[str, Float]] = {}
    frames = _frames_of(run)
    present = {*frames.collect_schema().names()}
    lacking = [pl.lit(None, kind).alias(name) for name, kind in schema.items() if name not in present]
    needed = {"frame", "stamp_ns", SEGMENT, *chain(*_OF_TRUTH), *chain(*map(_columns_of, criteria))}
    found = []
    with reading(f"{run.source_name}, with the filters and events of the criteria"):
        table = frames.with_columns(lacking).select(sorted(needed)).collect(engine="in-memory")
        lasts = before(pl.col("stamp_ns"), -1) - pl.col("stamp_ns")
        table = table.with_columns(lasts=lasts.fill_null(lasts.median()).fill_null(0) / NS_PER_S)
        known = {names[0] for names in _OF_TRUTH if any(table[name].null_count() < table.height for name in names)}
        for criterion in criteria:
            # one by one: polars takes quadratic time for many expressions in one query
            kept = table.select("frame", "lasts", keep=_sql(criterion.filter), value=_value(criterion)).filter("keep")
            if _is_whole(criterion):  # computed from the frames that fulfil the filter
                if criterion.filter not in whole:
                    whole[criterion.filter] = frame_values(run, kept["frame"].to_numpy(), parts_of(logs))
                values = whole[criterion.filter].get(str(criterion.metric))
                kept = kept if values is None else kept.with_columns(value=pl.Series(values))
            columns = _columns_of(criterion)
            of_truth = {names[0] for names in _OF_TRUTH if not set(columns[:1]).isdisjoint(names)}
            truth = TRUTH_OF.get(criterion.metric or "")
            skipped = "" if of_truth <= known else "no truth"
            if truth is not None and table[truth].null_count() < table.height:
                skipped = "truth decides"
            minutes = float(kept["lasts"].sum()) / _S_PER_MINUTE
            found.append(_Part(run, kept.select("frame", "value"), minutes, skipped))
    return found


def _is_whole(criterion: Criterion) -> bool:
    """Whether the metric is one figure of all frames."""
    return criterion.metric is not None and BY_NAME[criterion.metric].whole


def _columns_of(criterion: Criterion) -> list[str]:
    """The columns that a criterion needs; those of its value first."""
    value = _sql(criterion.event) if criterion.statistic == "rate" else _value(criterion)
    return [*value.meta.root_names(), *_sql(criterion.filter).meta.root_names()]


def _judged(criterion: Criterion, parts: Sequence[_Part], log: str) -> Result:
    frames = sum(part.rows.height for part in parts)
    reason = parts[0].skipped
    parts = [part for part in parts if not part.skipped]
    if not parts:
        return Result(criterion, log, "skipped", frames, reason=reason)
    frames = sum(part.rows.height for part in parts)
    if frames < criterion.least_frames:
        few = f"{number_of(frames, 'frame')}, expected {criterion.least_frames} at least"
        reason = few if frames else f"no frame fulfils the filter {criterion.filter}"
        return Result(criterion, log, "skipped", frames, reason=reason)
    values = pl.concat([part.rows["value"] for part in parts]).drop_nulls()
    coverage = values.len() / frames
    covered = coverage >= criterion.least_coverage
    value = _statistic(criterion, values, sum(part.minutes for part in parts))
    if value is None and covered:
        return Result(criterion, log, "skipped", frames, reason="no value in any frame")
    kept = value is None or _within_bound(criterion, value)
    outcome: Outcome = "passed" if kept and covered else "failed"
    worst = None if outcome == "passed" else _worst(criterion, parts, by_value=not kept)
    return Result(criterion, log, outcome, frames, value, coverage, worst=worst)


def _within_bound(criterion: Criterion, value: float) -> bool:
    return value <= criterion.most if criterion.most is not None else value >= (criterion.least or 0.0)


def _statistic(criterion: Criterion, values: pl.Series, minutes: float) -> float | None:
    """The statistic of known values; None without values, or for a rate without time."""
    if criterion.statistic == "rate":
        return float(values.sum()) / minutes if minutes else None
    if criterion.statistic == "share":
        values = (values.abs() <= criterion.within).cast(pl.Float64)
    quantile = _QUANTILES.get(criterion.statistic)
    found = values.mean() if quantile is None else values.quantile(quantile, "linear")
    return None if found is None else float(found)  # type: ignore[arg-type]


def _worst(criterion: Criterion, parts: Sequence[_Part], *, by_value: bool) -> WorstPlace | None:
    """The frame with the worst value; the first one without a value if only the coverage is too low."""
    rows = pl.concat([part.rows.with_columns(part=pl.lit(place)) for place, part in enumerate(parts)])
    is_share = criterion.statistic == "share"
    size = rows["value"].abs() if is_share else rows["value"]
    by_size = size if (criterion.most is not None) != is_share else -size
    at = (by_size if by_value else rows["value"].is_null().cast(pl.Int8)).arg_max()
    if at is None:
        return None
    run, frame = parts[rows["part"][at]].run, rows["frame"][at]
    return WorstPlace(run.name, frame, rows["value"][at], view_command(run.table_of(frame), frame))
