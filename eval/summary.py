"""Summaries of metrics tables, one by one and over all of them.

Each table is read once. The distributions of its columns are kept whole while all tables together have at most
EXACT_FRAMES rows; beyond that they are thinned. All other figures of a summary are exact and small.
"""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from typing import Final

import numpy as np
import polars as pl

from roadperc_stream.model import ReasonKind

from .configurations import Group
from .consistency import Consistency, added, consistency_of_run
from .quantities import NUMBERS, RANKED, TRACED, Quantity
from .runs import Run, collect
from .scan import extent, scan, worst_frames
from .scores import Score, Tallies, averaged, lag_frames, scores, tallied, tallied_together, tallies, traces
from .statistics import ColumnPools, Distribution, Statistics, exactly, moments, statistics, thinned

EXACT_FRAMES: Final = 2**18
"""Rows up to which quantiles over all tables are exact: 8 bytes per row and column, 160 MB in total."""
POINTS: Final = 2048
"""Values kept per column when there are more rows; each thinning moves ranks by 1/4096 at most."""
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
class Summary(Tallies):
    """Summary of one metrics table or of several.

    ``log_ids`` are digests of the logs' messages; ``configs`` and ``versions`` identify the replays. ``segments``
    is the number of segments, ``span_s`` the sum of their time spans, ``longest_gap_s`` the longest time between two
    frames of one. ``statistics`` has the numeric columns with values, ``worst`` the worst frames per column.
    ``correlations`` are those of each side's smoothed offset with its truth, by shift. ``consistency`` has the
    quantities with known truth. ``mounting_height_m`` is the camera's height by the transforms of a single run.
    """

    name: str
    frames: int
    runs: int
    log_ids: tuple[str, ...]
    configs: tuple[str, ...]
    versions: tuple[str, ...]
    statistics: Mapping[str, Statistics]
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


def summarise_group(group: Group, worst: int) -> tuple[list[Summary], Summary]:
    """Summaries of a group's runs, each with at least one row, and the summary over all of them.

    Raises:
        TableError: the data of a table cannot be read.
    """
    runs = group.runs
    if len(runs) == 1:
        together = summarise_run(runs[0], worst)
        return [together], replace(together, name=group.name)
    frames = sum(run.frames for run in runs)
    points = frames if frames <= EXACT_FRAMES else POINTS
    columns = ColumnPools(points)
    summaries = []
    read = partial(_read, worst=worst, points=points)
    with ThreadPoolExecutor(_AT_ONCE) as threads:
        for at in range(0, len(runs), _AHEAD):
            for summary, distributions in threads.map(read, runs[at : at + _AHEAD]):
                summaries.append(summary)
                for column, part in distributions.items():
                    columns.add(column, summary.statistics[column], part)
    return summaries, _together(group.name, summaries, columns.statistics(q.column for q in NUMBERS), worst)


def summarise_run(run: Run, worst: int) -> Summary:
    """Summary of one table with at least one row, and the ``worst`` worst frames by each quantity.

    Raises:
        TableError: the table's data cannot be read.
    """
    return _read(run, worst, run.frames)[0]


def _read(run: Run, worst: int, points: int) -> tuple[Summary, dict[str, Distribution]]:
    """Summary of a table, and the distributions of its columns with at most ``points`` values each."""
    frames = collect(scan(run), run.source_name)
    found = frames.select(_facts(worst)).row(0, named=True)
    columns = {q.column: frames[q.column].drop_nulls() for q in NUMBERS}
    distributions = {name: exactly(np.sort(values.to_numpy())) for name, values in columns.items() if len(values)}
    present = {name: statistics([moments(whole.values)], whole) for name, whole in distributions.items()}
    summary = Summary(
        **vars(tallied(found)),
        name=run.name,
        frames=run.frames,
        runs=1,
        log_ids=tuple(found["log_ids"]),
        configs=(run.config_digest,),
        versions=(run.version,),
        segments=found["segments"],
        span_s=found["span_s"],
        longest_gap_s=found["longest_gap_s"] or 0.0,
        mounting_height_m=run.mounting_height_m,
        statistics=present,
        correlations={side: tuple(found[f"correlations {side}"]) for side in TRACED},
        consistency=consistency_of_run(run),
        worst={
            q.column: tuple(WorstFrame(run.name, **row) for row in found[f"worst {q.column}"])
            for q in RANKED
            if q.column in present
        },
    )
    return summary, {name: thinned(distribution, points) for name, distribution in distributions.items()}


def _together(name: str, summaries: Sequence[Summary], pooled: Mapping[str, Statistics], worst: int) -> Summary:
    return Summary(
        **vars(tallied_together(summaries)),
        name=name,
        frames=sum(summary.frames for summary in summaries),
        runs=len(summaries),
        log_ids=_distinct(summary.log_ids for summary in summaries),
        configs=_distinct(summary.configs for summary in summaries),
        versions=_distinct(summary.versions for summary in summaries),
        segments=sum(summary.segments for summary in summaries),
        span_s=sum(summary.span_s for summary in summaries),
        longest_gap_s=max(summary.longest_gap_s for summary in summaries),
        statistics=pooled,
        correlations={
            side: averaged((summary.frames, summary.correlations[side]) for summary in summaries) for side in TRACED
        },
        consistency=added(summary.consistency for summary in summaries),
        worst={q.column: ranking for q in RANKED if (ranking := _merged(summaries, q, worst))},
    )


@cache  # the same for all tables
def _facts(worst: int) -> list[pl.Expr]:
    return [*extent(), *tallies(), *traces(), *(worst_frames(quantity, worst) for quantity in RANKED)]


def _merged(summaries: Iterable[Summary], quantity: Quantity, worst: int) -> tuple[WorstFrame, ...]:
    frames = chain.from_iterable(summary.worst.get(quantity.column, ()) for summary in summaries)
    return worst_of(frames, quantity, worst)


def worst_of(frames: Iterable[WorstFrame], quantity: Quantity, number: int) -> tuple[WorstFrame, ...]:
    """The worst of the worst frames of several runs; equal values stay in the order of the runs."""
    high = quantity.better == "high"
    return tuple(sorted(frames, key=lambda frame: frame.value if high else -abs(frame.value))[:number])


def _distinct(parts: Iterable[Iterable[str]]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(chain.from_iterable(parts)))
