"""Metrics tables to small summaries, one table at a time.

Over all tables, counts and worst frames are merged from those of each; quantiles are exact, so they are taken again
from the tables, a few columns of all of them at a time.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import polars as pl

from .quantities import CATEGORIES, NUMBERS, SUSPECT, TRUTH, Quantity
from .runs import Run
from .scan import collect, counts, extent, scan, statistics, worst_frames

COLUMNS_AT_ONCE: Final = 4
"""Columns of all tables in memory together: four of ten million rows take 320 MB."""
_RANKED: Final = (*TRUTH, *SUSPECT)


@dataclass(frozen=True)
class Statistics:
    """A numeric column over the frames that have a value, in its own unit; quantiles interpolate linearly.

    ``abs_...`` are over absolute values, ``std`` is the population's, ``total`` the sum.
    """

    values: int
    total: float
    std: float
    least: float
    p5: float
    median: float
    p95: float
    p99: float
    abs_median: float
    abs_p95: float
    abs_most: float


@dataclass(frozen=True)
class WorstFrame:
    """One of the worst frames by some quantity: where it is, and the value there in the quantity's unit."""

    run: str
    frame: int
    since_start_s: float
    stamp_ns: int
    value: float


@dataclass(frozen=True)
class Summary:
    """A metrics table in numbers, or several together.

    ``log_ids`` are digests of the logs' messages, ``configs`` and ``versions`` what made the tables; ``span_s`` are the
    seconds from first to last frame of each table, ``longest_gap_s`` the longest time between two frames.
    ``statistics`` holds the numeric columns that have values; ``categories`` counts the values of each text column;
    ``missing`` counts frames per missing role, ``incomplete`` frames where any role is missing, ``reasons`` frames per
    text; ``worst`` holds the worst frames, the worst first.
    """

    name: str
    frames: int
    runs: int
    log_ids: tuple[str, ...]
    configs: tuple[str, ...]
    versions: tuple[str, ...]
    span_s: float
    longest_gap_s: float
    incomplete: int
    statistics: Mapping[str, Statistics]
    categories: Mapping[str, Counter[str]]
    missing: Counter[str]
    reasons: Counter[str]
    worst: Mapping[str, tuple[WorstFrame, ...]] = field(repr=False)

    @property
    def rate_hz(self) -> float | None:
        """Frames a second of the logs' own time; None where there is no span, as with a single frame."""
        return (self.frames - self.runs) / self.span_s if self.span_s > 0 else None

    def coverage(self, column: str) -> float:
        """Share of the frames that have a value in a numeric column."""
        found = self.statistics.get(column)
        return found.values / self.frames if found else 0.0

    def share(self, column: str, *values: str) -> float:
        """Share of the frames that have one of these values in a text column."""
        return sum(self.categories[column][value] for value in values) / self.frames


def summarise_run(run: Run, worst: int) -> Summary:
    """Summary of one table of at least one row, with the ``worst`` worst frames by each quantity.

    Raises:
        TableError: the table's data cannot be read.
    """
    found = collect(scan(run).select(_everything(worst)), str(run.path)).row(0, named=True)
    present = _present(found, NUMBERS)
    return Summary(
        run.name,
        run.frames,
        1,
        tuple(found["log_ids"]),
        (run.config_digest,),
        (run.version,),
        found["span_s"],
        found["longest_gap_s"] or 0.0,
        found["incomplete"],
        present,
        {name: _counter(found[name]) for name in CATEGORIES},
        _counter(found["missing"]),
        _counter(found["reasons"]),
        {q.column: _ranking(run, found[f"worst {q.column}"]) for q in _RANKED if q.column in present},
    )


def summarise_all(runs: Sequence[Run], summaries: Sequence[Summary], worst: int) -> Summary:
    """Summary over all tables, from the summary of each and, for the quantiles, from the tables again.

    Raises:
        TableError: the tables' data cannot be read.
    """
    return Summary(
        f"all {len(runs)} logs",
        sum(summary.frames for summary in summaries),
        len(runs),
        _distinct(name for summary in summaries for name in summary.log_ids),
        _distinct(name for summary in summaries for name in summary.configs),
        _distinct(name for summary in summaries for name in summary.versions),
        sum(summary.span_s for summary in summaries),
        max(summary.longest_gap_s for summary in summaries),
        sum(summary.incomplete for summary in summaries),
        _statistics_of_all(runs, {name for summary in summaries for name in summary.statistics}),
        {name: _added(summary.categories[name] for summary in summaries) for name in CATEGORIES},
        _added(summary.missing for summary in summaries),
        _added(summary.reasons for summary in summaries),
        {q.column: ranking for q in _RANKED if (ranking := _merged(summaries, q, worst))},
    )


def _everything(worst: int) -> list[pl.Expr]:
    return [
        *extent(),
        *(statistics(quantity.column) for quantity in NUMBERS),
        *(counts(name) for name in CATEGORIES),
        *(counts(name, of_lists=True) for name in ("missing", "reasons")),
        *(worst_frames(quantity, worst) for quantity in _RANKED),
    ]


def _statistics_of_all(runs: Sequence[Run], columns: set[str]) -> dict[str, Statistics]:
    """Exact statistics over all tables; ``columns`` are those with a value in any."""
    quantities = [quantity for quantity in NUMBERS if quantity.column in columns]
    found: dict[str, Statistics] = {}
    for some in _batches(quantities):
        # Table by table: a thousand scans in one query hold a thousand files open and several times the memory.
        joined = pl.concat([collect(scan(run).select(q.column for q in some), str(run.path)) for run in runs])
        for quantity in some:
            found |= _present(joined.select(statistics(quantity.column)).row(0, named=True), [quantity])
    return found


def _batches(quantities: Sequence[Quantity]) -> Iterable[Sequence[Quantity]]:
    return (quantities[at : at + COLUMNS_AT_ONCE] for at in range(0, len(quantities), COLUMNS_AT_ONCE))


def _present(row: Mapping[str, Any], quantities: Iterable[Quantity]) -> dict[str, Statistics]:
    return {q.column: Statistics(**row[q.column]) for q in quantities if row[q.column]["values"]}


def _ranking(run: Run, rows: Iterable[Mapping[str, Any]]) -> tuple[WorstFrame, ...]:
    return tuple(WorstFrame(run.name, **row) for row in rows)


def _merged(summaries: Iterable[Summary], quantity: Quantity, worst: int) -> tuple[WorstFrame, ...]:
    """The worst frames of all from the worst of each; equals stay in the order of the runs."""
    frames = [frame for summary in summaries for frame in summary.worst.get(quantity.column, ())]
    if quantity.worse == "low":
        return tuple(sorted(frames, key=lambda frame: frame.value)[:worst])
    return tuple(sorted(frames, key=lambda frame: -abs(frame.value))[:worst])


def _counter(rows: Iterable[Mapping[str, Any]]) -> Counter[str]:
    return Counter({row["text"]: row["count"] for row in rows})


def _added(counters: Iterable[Counter[str]]) -> Counter[str]:
    total: Counter[str] = Counter()
    for counter in counters:
        total += counter
    return total


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
