"""The figures of sets of frames: of a run, of several runs, of a slice, or of a group of a dataset."""

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any, Final

import numpy as np
import polars as pl

from roadperc_stream.geometry import Float
from roadperc_stream.model import ReasonKind, reason_of
from roadperc_stream.output.reason_counts import ReasonCounts, grouped, merged
from roadperc_stream.schemas.columns import RATIO
from roadperc_stream.system.text import number

from ..lanes.precision_recall import Score, scores
from ..options import APART_NS
from ..report_columns import CATEGORIES, CONFUSED, COUNTS, NUMBERS, RANKED, STATES, TRACED, Quantity
from .consistency import Consistency, added, consistency_by_run
from .lag import averaged, lag_frames, traces
from .sources import RUN, Frames, Numbers
from .statistics import Statistics, statistics


@dataclass(frozen=True)
class Columns:
    """The numeric columns to summarise.

    ``summarised`` have statistics, and of ``counted`` only the frames with a value are counted. ``instead`` maps a
    column to another one: it is summarised, too, if the other one has no value in any frame.
    """

    summarised: Collection[str]
    counted: Sequence[str] = ()
    instead: Mapping[str, str] = field(default_factory=dict)


ALL: Final = Columns(frozenset(quantity.column for quantity in NUMBERS))
"""All columns of a report."""
BETWEEN: Final = "\t"
"""Separates a true text from its estimate."""
_GROUP: Final = "group"
_CANDIDATES: Final = 100
"""Frames that are searched for each different moment among the worst ones."""
_THREADS: Final = 2
"""Columns that are summarised at the same time; each needs memory for several copies."""
ByColumn = Callable[[str, Float], object]
_TEXTS: Final = {
    **{name: pl.col(name) for name in CATEGORIES},
    **{
        name: pl.concat_str(truth, pl.col(estimate).fill_null(""), separator=BETWEEN)
        for name, (truth, estimate) in CONFUSED.items()
    },
}
"""The counted texts: values of columns, and true texts with their estimates, which may be empty."""
_STATES: Final = {name: text for name, text in _TEXTS.items() if name in STATES}


@dataclass(frozen=True)
class WorstFrame:
    """One of the worst frames by a quantity, its run and configuration; ``value`` is in the quantity's unit."""

    run: str
    config: str
    frame: int
    segment: int
    since_start_s: float
    stamp_ns: int
    value: float

    def is_beside(self, other: "WorstFrame") -> bool:
        """Whether both show the same moment: less than a second apart in one segment of a log."""
        same = (self.run, self.config, self.segment) == (other.run, other.config, other.segment)
        return same and abs(self.stamp_ns - other.stamp_ns) < APART_NS


@dataclass(frozen=True)
class Summary:
    """The figures of a set of rows.

    ``log_ids`` are digests of the logs' messages; ``configs`` and ``versions`` identify the replays. ``statistics`` has
    the numeric columns with values, ``counted`` the numbers of values of others. ``incomplete`` counts the frames in
    which any role lacks a message, ``missing`` those of each role. ``categories`` counts the values of each text
    column, ``reasons`` the reasons of absent outputs. ``totals`` are the sums of the count columns that have values.
    ``worst`` has the worst frames per column.

    ``segments`` is the number of segments, ``span_s`` the sum of their time spans, ``longest_gap_s`` the longest time
    between two frames of one; they are known of whole runs only. ``mounting_height_m`` is the camera's height by the
    transforms of a single run. ``correlations`` are those of each side's smoothed offset with its truth, by shift, and
    ``consistency`` has the quantities with known truth; both are empty in short summaries.
    """

    name: str
    frames: int
    runs: int
    log_ids: tuple[str, ...]
    configs: tuple[str, ...]
    versions: tuple[str, ...]
    incomplete: int = 0
    categories: Mapping[str, Counter[str]] = field(default_factory=dict)
    missing: Counter[str] = field(default_factory=Counter)
    reasons: ReasonCounts = field(default_factory=dict)
    counted: Mapping[str, int] = field(default_factory=dict)
    totals: Mapping[str, int] = field(default_factory=dict)
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
        return (found.values if found else self.counted.get(column, 0)) / self.frames

    def share(self, column: str, *values: str) -> float:
        """Share of frames with one of these values in a text column."""
        return sum(self.categories[column][value] for value in values) / self.frames

    def reason_share(self, kind: ReasonKind) -> float:
        """Share of frames with a reason."""
        found = self.reasons.get(kind)
        return found.frames / self.frames if found else 0.0

    @property
    def scores(self) -> list[Score]:
        """Precision, recall and F1 of the counted outputs."""
        return scores(self.totals)

    def lag_frames(self, side: str) -> int | None:
        """Frames by which a side's smoothed offset lags the truth; None if unknown."""
        return lag_frames(self.correlations[side])


def frames_in_segments(summary: Summary) -> str:
    """The number of frames, and of segments if a run has several."""
    segments = f" in {summary.segments} segments" if summary.segments > summary.runs else ""
    return f"{number(summary.frames, 'frame')}{segments}"


@dataclass(frozen=True)
class Groups:
    """Groups of frames: their ``names``, and the number of the group of each frame, (N,), and of each run.

    ``of_runs`` is None if the frames of a run are in several groups.
    """

    names: Sequence[str]
    of_frames: Numbers
    of_runs: Numbers | None = None

    @cached_property
    def frames(self) -> list[Numbers]:
        """The indices of the frames of each group."""
        ends = np.cumsum(np.bincount(self.of_frames, minlength=len(self.names)))
        return np.split(np.argsort(self.of_frames, kind="stable"), ends[:-1])


def groups_of_runs(frames: Frames, names: Sequence[str]) -> Groups:
    """Groups of whole runs; ``names`` has the name of the group of each run."""
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    of_runs = np.array([numbers[name] for name in names])
    return Groups(list(numbers), of_runs[frames.run], of_runs)


def summarise(
    frames: Frames,
    groupings: Sequence[Groups],
    columns: Columns = ALL,
    worst: int = 1,
    *,
    also: ByColumn | None = None,
) -> list[list[Summary]]:
    """The figures of some ``columns`` in the groups of each grouping, with the ``worst`` frames by each quantity.

    Each summarised column is read once, and ``also`` is called with its name and its values, in several threads.
    Summaries of all columns also have counts, correlations and consistency.

    Raises:
        TableError: a table cannot be read.
    """
    statistics_by: list[list[dict[str, Statistics]]] = [[{} for _ in groups.names] for groups in groupings]
    worst_by: list[list[dict[str, tuple[WorstFrame, ...]]]] = [[{} for _ in groups.names] for groups in groupings]
    whole = columns is ALL

    def add(name: str, values: Float) -> None:
        for k, groups in enumerate(groupings):
            for group, at in enumerate(groups.frames):
                own = values[at]
                known = own[np.isfinite(own)]
                if not len(known):
                    continue
                statistics_by[k][group][name] = statistics(known)
                if worst and name in RANKED and (ranked := worst_frames(frames, RANKED[name], own, at, worst)):
                    worst_by[k][group][name] = ranked
        if also is not None:
            also(name, values)

    with ThreadPoolExecutor(_THREADS) as threads:
        for of_names in frames.columns(columns.summarised):
            list(threads.map(add, of_names, of_names.values()))
        found = {*chain.from_iterable(statistics_by[0])}
        more = {name for name, other in columns.instead.items() if other not in found} - {*columns.summarised}
        for of_names in frames.columns(more):
            list(threads.map(add, of_names, of_names.values()))
    by_run = _by_run(frames) if whole else {}
    totals = frames.beside(COUNTS) if whole else None
    counts = _counts(frames, groupings, _TEXTS if whole else _STATES, columns.counted)
    return [
        [
            replace(
                _of_runs(frames, groups, number, by_run),
                **counts[k][number],
                totals=_totals(totals, groups.frames[number]),
                statistics=statistics_by[k][number],
                worst=worst_by[k][number],
            )
            for number in range(len(groups.names))
        ]
        for k, groups in enumerate(groupings)
    ]


def worst_frames(frames: Frames, quantity: Quantity, values: Float, at: Numbers, number: int) -> tuple[WorstFrame, ...]:
    """The worst of the frames ``at`` by their values, (N,) both, the worst first, then the earliest.

    They are different moments: at least a second apart, or in other segments. Frames with the best possible value
    are left out, and those whose value is not finite.
    """
    high = quantity.better == "high"
    badness = -values if high else np.abs(values)
    best = (-1.0 if quantity.unit == RATIO else -np.inf) if high else 0.0
    flawed = (badness > best) & (badness < np.inf)
    candidates = number if number == 1 else _CANDIDATES * number
    if candidates < np.count_nonzero(flawed):
        flawed &= badness >= np.partition(badness[flawed], -candidates)[-candidates]
    at, values, badness = at[flawed], values[flawed], badness[flawed]
    order = np.lexsort((frames.stamp_ns[at], frames.segment[at], -badness))[:candidates]
    chosen: list[WorstFrame] = []
    for k in order.tolist():
        found = frame_at(frames, int(at[k]), float(values[k]))
        if not any(map(found.is_beside, chosen)):
            chosen.append(found)
        if len(chosen) == number:
            break
    return tuple(chosen)


def frame_at(frames: Frames, at: int, value: float = math.nan) -> WorstFrame:
    """The frame with an index, and its value."""
    run = int(frames.run[at])
    return WorstFrame(
        run=frames.runs["log"][run],
        config=frames.runs["config"][run],
        frame=int(frames.frame[at]),
        segment=int(frames.own_segments[frames.segment[at]]),
        since_start_s=frames.since_start_s(at),
        stamp_ns=int(frames.stamp_ns[at]),
        value=value,
    )


def _of_runs(frames: Frames, groups: Groups, number: int, by_run: Mapping[str, Sequence[Any]]) -> Summary:
    """The facts of the runs of a group; if they are in no other group, also their extent and what is ``by_run``."""
    own = np.unique(frames.run[groups.frames[number]])
    runs = frames.runs[own]
    summary = Summary(
        name=groups.names[number],
        frames=len(groups.frames[number]),
        runs=len(own),
        log_ids=tuple(runs["log_ids"].explode().unique(maintain_order=True)),
        configs=tuple(runs["config"].unique(maintain_order=True)),
        versions=tuple(runs["version"].drop_nulls().unique(maintain_order=True)),
    )
    if groups.of_runs is None:
        return summary
    parts = {name: [found[run] for run in own] for name, found in by_run.items()}
    height = runs["mounting_height_m"][0] if "mounting_height_m" in runs.columns and len(own) == 1 else None
    return replace(
        summary,
        segments=int(runs["segments"].sum()),
        span_s=float(runs["span_s"].sum()),
        longest_gap_s=float(runs["longest_gap_s"].max()),  # type: ignore[arg-type]
        mounting_height_m=height,
        correlations={
            side: averaged(zip(runs["frames"], (found[side] for found in parts["correlations"]), strict=True))
            for side in (TRACED if by_run else ())
        },
        consistency=added(parts.get("consistency", ())),
    )


def _by_run(frames: Frames) -> dict[str, Sequence[Any]]:
    """The correlations and the consistency of each run."""
    columns = [name for pair in TRACED.values() for name in pair]
    found = frames.beside(columns).group_by(RUN, maintain_order=True).agg(traces()).drop(RUN)
    return {"correlations": list(found.iter_rows(named=True)), "consistency": consistency_by_run(frames)}


def _totals(counts: pl.DataFrame | None, at: Numbers) -> dict[str, int]:
    """The sums of the count columns that have values in the frames ``at``."""
    if counts is None:
        return {}
    sums = counts[at].select(pl.when(pl.col(name).count() > 0).then(pl.col(name).sum()) for name in COUNTS)
    return {name: int(total) for name, total in sums.row(0, named=True).items() if total is not None}


def _counts(
    frames: Frames, groupings: Sequence[Groups], texts: Mapping[str, pl.Expr], counted: Sequence[str]
) -> list[list[dict[str, Any]]]:
    """The counts of texts, missing messages, reasons and known numbers in each group of each grouping."""
    result = [[_Counts() for _ in groups.names] for groups in groupings]
    columns = [text.alias(name) for name, text in texts.items()]
    begin = 0
    for batch in frames.source.batches(*columns, "missing", "reasons", *counted):
        for groups, found in zip(groupings, result, strict=True):
            group = pl.Series(_GROUP, groups.of_frames[begin : begin + batch.height])
            known = batch.select(group, pl.col("missing").list.len() > 0, pl.col(list(counted)).is_finite())
            for place, incomplete, *known_values in known.group_by(_GROUP).sum().iter_rows():
                found[place].incomplete += incomplete
                found[place].counted.update(dict(zip(counted, known_values, strict=True)))
            for name in (*texts, "missing", "reasons"):
                rows = pl.DataFrame([group, batch[name].alias("text")])
                if rows.schema["text"].base_type() is pl.List:
                    rows = rows.filter(pl.col("text").list.len() > 0).explode("text")
                counts = rows.drop_nulls("text").group_by(_GROUP, "text", maintain_order=True).len()
                for (place,), part in (
                    counts.sort("len", descending=True, maintain_order=True)
                    .partition_by(_GROUP, as_dict=True, maintain_order=True)
                    .items()
                ):
                    found[place].add(name, list(part.select("text", "len").iter_rows()))
        begin += batch.height
    return [[vars(item) for item in found] for found in result]


@dataclass
class _Counts:
    """The counts of a group, as in ``Summary``."""

    categories: dict[str, Counter[str]] = field(default_factory=lambda: {name: Counter() for name in _TEXTS})
    missing: Counter[str] = field(default_factory=Counter)
    incomplete: int = 0
    reasons: ReasonCounts = field(default_factory=dict)
    counted: Counter[str] = field(default_factory=Counter)

    def add(self, column: str, counts: Sequence[tuple[Any, int]]) -> None:
        """Add the counts of the texts of a column; those of reasons are mappings."""
        if column == "reasons":
            self.reasons = merged([self.reasons, grouped((reason_of(**fields), count) for fields, count in counts)])
        else:
            (self.missing if column == "missing" else self.categories[column]).update(dict(counts))
