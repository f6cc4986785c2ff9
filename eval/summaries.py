"""The figures of a set of rows: of a run, of several runs, of a slice, or of a group of a dataset.

Rows are added in parts. The distributions of the columns are kept whole up to EXACT_FRAMES rows; beyond that they are
thinned. All other figures are exact and small.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from typing import Any, Final

import numpy as np
import polars as pl

from roadperc_stream.model import ReasonKind, reason_of
from roadperc_stream.output.reason_counts import ReasonCounts, grouped, merged

from .configurations import Group
from .consistency import Consistency, added, consistency_of_run
from .dataset.keys import LOG
from .lag import averaged, lag_frames, traces
from .lanes.precision_recall import Score, scores
from .report_columns import CATEGORIES, CONFUSED, COUNTS, NUMBERS, RANKED, TRACED, Quantity
from .runs import Run, collect
from .scan import extent, scan, worst_frames
from .statistics import ColumnPools, Distribution, Moments, Statistics, exactly, moments, thinned

EXACT_FRAMES: Final = 2**18
"""Rows up to which quantiles are exact: 8 bytes per row and column, 160 MB in total."""
POINTS: Final = 2048
"""Values kept per column when there are more rows; each thinning moves ranks by 1/4096 at most."""
BETWEEN: Final = "\t"
"""Separates a true text from its estimate."""
_AT_ONCE: Final = 2
"""Tables read at the same time; polars uses several threads for each."""
_AHEAD: Final = 64
"""Tables read before the first is merged; limits the memory."""


@dataclass(frozen=True)
class WorstFrame:
    """One of the worst frames by a quantity; ``value`` is in the quantity's unit."""

    run: str
    frame: int
    segment: int
    since_start_s: float
    stamp_ns: int
    value: float


@dataclass(frozen=True)
class Summary:
    """The figures of a set of rows.

    ``log_ids`` are digests of the logs' messages; ``configs`` and ``versions`` identify the replays. ``statistics`` has
    the numeric columns with values. ``incomplete`` counts the frames in which any role lacks a message, ``missing``
    those of each role. ``categories`` counts the values of each text column, ``reasons`` the reasons of absent outputs.
    ``totals`` are the sums of the count columns that have values. ``worst`` has the worst frames per column.

    The others are known of whole tables only. ``segments`` is the number of segments, ``span_s`` the sum of their time
    spans, ``longest_gap_s`` the longest time between two frames of one. ``correlations`` are those of each side's
    smoothed offset with its truth, by shift. ``consistency`` has the quantities with known truth. ``mounting_height_m``
    is the camera's height by the transforms of a single run.
    """

    name: str
    frames: int
    runs: int
    log_ids: tuple[str, ...]
    configs: tuple[str, ...]
    versions: tuple[str, ...]
    incomplete: int
    categories: Mapping[str, Counter[str]]
    missing: Counter[str]
    reasons: ReasonCounts
    totals: Mapping[str, int]
    statistics: Mapping[str, Statistics] = field(default_factory=dict)
    segments: int = 0
    span_s: float = 0.0
    longest_gap_s: float = 0.0
    mounting_height_m: float | None = None
    correlations: Mapping[str, tuple[float | None, ...]] = field(default_factory=dict)
    consistency: Mapping[str, Consistency] = field(default_factory=dict)
    worst: Mapping[str, tuple[WorstFrame, ...]] = field(default_factory=dict, repr=False)

    @property
    def rate_hz(self) -> float | None:
        """Frames per second of log time; None without a time span, as with a single frame."""
        return (self.frames - self.segments) / self.span_s if self.span_s > 0 else None

    def coverage(self, column: str) -> float:
        """Share of frames with a value in a numeric column."""
        found = self.statistics.get(column)
        return found.values / self.frames if found else 0.0

    def share(self, column: str, *values: str) -> float:
        """Share of frames with one of these values in a text column."""
        return sum(self.categories[column][value] for value in values) / self.frames

    def reason_share(self, kind: ReasonKind) -> float:
        """Share of frames with a reason."""
        found = self.reasons.get(kind)
        return found.frames / self.frames if found else 0.0

    @property
    def rank_error(self) -> float:
        """Largest rank error of the quantiles, as a ratio; 0 if they are exact."""
        return max((found.rank_error for found in self.statistics.values()), default=0.0)

    @property
    def scores(self) -> list[Score]:
        """Precision, recall and F1 of the counted outputs."""
        return scores(self.totals)

    def lag_frames(self, side: str) -> int | None:
        """Frames by which a side's smoothed offset lags the truth; None if unknown."""
        return lag_frames(self.correlations[side])


class Figures:
    """The figures of rows that are added in parts, with the ``worst`` worst frames by each quantity.

    Distributions have at most ``points`` values each.
    """

    def __init__(self, points: int = EXACT_FRAMES, worst: int = 0) -> None:
        self._most = worst
        self._parts: list[Summary] = []
        self._runs: dict[object, None] = {}
        self._columns = ColumnPools(points)

    def add(
        self, rows: pl.DataFrame, run: Run | None = None, *, whole: bool = False, threads: Executor | None = None
    ) -> None:
        """Add rows with the columns of ``scanned`` and ``LOG``, at least one; they are of ``run``, ``whole`` if all.

        Raises:
            TableError: the data of the run's objects cannot be read.
        """
        found = rows.select(_facts(self._most, whole)).row(0, named=True)
        logs = list(rows.select(LOG).unique(maintain_order=True).iter_rows())
        self._runs.update(dict.fromkeys([run.name] if run and whole else logs))
        self._parts.append(_part(found, rows.height, logs, run, whole=whole))
        names = [quantity.column for quantity in NUMBERS]
        mapped = threads.map if threads else map
        distribution = partial(_distribution, points=self._columns.points)
        columns = mapped(distribution, (rows[name] for name in names))
        for name, column in zip(names, columns, strict=True):
            if column is not None:
                self._columns.add(name, *column)

    def extend(self, other: "Figures") -> None:
        """Add the rows of another one."""
        self._parts += other._parts
        self._runs |= other._runs
        self._columns.extend(other._columns)

    def limit(self, points: int) -> None:
        """Reduce the number of points per distribution."""
        self._columns.limit(points)

    def summary(self, name: str) -> Summary:
        """The figures of all rows."""
        (first, *others) = self._parts
        together = _together(self._parts, self._most) if others else first
        statistics = self._columns.statistics(quantity.column for quantity in NUMBERS)
        return replace(together, name=name, runs=len(self._runs), statistics=statistics)


def summarise_group(group: Group, worst: int) -> tuple[list[Summary], Summary]:
    """Summaries of a group's runs, each with at least one row, and the summary over all of them.

    Raises:
        TableError: the data of a table cannot be read.
    """
    runs = group.runs
    frames = sum(run.frames for run in runs)
    points = max(frames, 1) if frames <= EXACT_FRAMES else POINTS
    together, summaries = Figures(points, worst), []
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        for at in range(0, len(runs), _AHEAD):
            for summary, own in threads.map(partial(_read, worst=worst, points=points), runs[at : at + _AHEAD]):
                summaries.append(summary)
                together.extend(own)
    return summaries, together.summary(group.name)


def summarise_run(run: Run, worst: int) -> Summary:
    """Summary of one table with at least one row, and the ``worst`` worst frames by each quantity.

    Raises:
        TableError: the table's data cannot be read.
    """
    return _read(run, worst, run.frames)[0]


def _read(run: Run, worst: int, points: int) -> tuple[Summary, Figures]:
    """The summary of a table, and its figures with at most ``points`` values per column."""
    rows = collect(scan(run).with_columns(pl.lit(run.config_digest).alias("config")), run.source_name)
    found = Figures(run.frames, worst)
    found.add(rows, run, whole=True)
    summary = found.summary(run.name)
    found.limit(points)
    return summary, found


def _part(
    found: Mapping[str, Any], frames: int, logs: Sequence[tuple[str, str]], run: Run | None, *, whole: bool
) -> Summary:
    part = Summary(
        name="",
        frames=frames,
        runs=0,
        log_ids=_distinct([(log_id for log_id, _ in logs)]),
        configs=_distinct([(config for _, config in logs)]),
        versions=(),
        incomplete=found["incomplete"],
        categories={name: _counter(found[name]) for name in (*CATEGORIES, *CONFUSED)},
        missing=_counter(found["missing"]),
        reasons=grouped((reason_of(**item["text"]), item["count"]) for item in found["reasons"]),
        totals={name: found[name] for name in COUNTS if found[name] is not None},
        worst={
            q.column: tuple(WorstFrame(run.name if run else "", **row) for row in rows)
            for q in RANKED
            if (rows := found.get(f"worst {q.column}"))
        },
    )
    if run is None or not whole:
        return part
    return replace(
        part,
        versions=(run.version,),
        segments=found["segments"],
        span_s=found["span_s"],
        longest_gap_s=found["longest_gap_s"] or 0.0,
        mounting_height_m=run.mounting_height_m,
        correlations={side: tuple(found[f"correlations {side}"]) for side in TRACED},
        consistency=consistency_of_run(run),
    )


def _together(parts: Sequence[Summary], worst: int) -> Summary:
    return Summary(
        name="",
        frames=sum(part.frames for part in parts),
        runs=0,
        log_ids=_distinct(part.log_ids for part in parts),
        configs=_distinct(part.configs for part in parts),
        versions=_distinct(part.versions for part in parts),
        incomplete=sum(part.incomplete for part in parts),
        categories={name: _sum(part.categories[name] for part in parts) for name in (*CATEGORIES, *CONFUSED)},
        missing=_sum(part.missing for part in parts),
        reasons=merged(part.reasons for part in parts),
        totals=_sum(part.totals for part in parts),
        segments=sum(part.segments for part in parts),
        span_s=sum(part.span_s for part in parts),
        longest_gap_s=max(part.longest_gap_s for part in parts),
        correlations={
            side: averaged((part.frames, part.correlations[side]) for part in parts if part.correlations)
            for side in TRACED
            if parts[0].correlations
        },
        consistency=added(part.consistency for part in parts),
        worst={q.column: found for q in RANKED if (found := _worst_of(parts, q, worst))},
    )


def _worst_of(parts: Iterable[Summary], quantity: Quantity, number: int) -> tuple[WorstFrame, ...]:
    """The worst of the worst frames of several parts; equal values stay in the order of the parts."""
    frames = chain.from_iterable(part.worst.get(quantity.column, ()) for part in parts)
    high = quantity.better == "high"
    return tuple(sorted(frames, key=lambda frame: frame.value if high else -abs(frame.value))[:number])


def _distribution(column: pl.Series, points: int) -> tuple[Moments, Distribution] | None:
    """Moments and distribution of values, which has at most ``points``; None without values."""
    values = np.sort(column.drop_nulls().to_numpy())
    return (moments(values), thinned(exactly(values), points)) if len(values) else None


@cache  # the same for all tables
def _facts(worst: int, whole: bool) -> list[pl.Expr]:
    """The expressions of a part: counts of frames and texts, sums that are null without values, and worst frames."""
    return [
        (pl.col("missing").list.len() > 0).sum().alias("incomplete"),
        *(_counted(pl.col(name)).alias(name) for name in CATEGORIES),
        *(_pairs(*columns).alias(name) for name, columns in CONFUSED.items()),
        *(_counted(pl.col(name).explode()).alias(name) for name in ("missing", "reasons")),
        *(pl.when(pl.col(name).count() > 0).then(pl.col(name).sum()).cast(pl.Int64) for name in COUNTS),
        *([*extent(), *traces()] if whole else []),
        *(worst_frames(quantity, worst) for quantity in RANKED if worst),
    ]


def _pairs(truth: str, estimate: str) -> pl.Expr:
    """Number of occurrences of each true text with each estimate, which may be empty, separated by ``BETWEEN``."""
    return _counted(pl.concat_str(truth, pl.col(estimate).fill_null(""), separator=BETWEEN))


def _counted(texts: pl.Expr) -> pl.Expr:
    """Number of occurrences of each text: a list of structs of ``text`` and ``count``."""
    return texts.drop_nulls().value_counts(sort=True).struct.rename_fields(["text", "count"]).implode()


def _counter(rows: Iterable[Mapping[str, Any]]) -> Counter[str]:
    return Counter({row["text"]: row["count"] for row in rows})


def _sum(counters: Iterable[Mapping[str, int]]) -> Counter[str]:
    total: Counter[str] = Counter()
    for counter in counters:
        total.update(counter)
    return total


def _distinct(parts: Iterable[Iterable[str]]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(chain.from_iterable(parts)))
