"""What is known of the frames of a group, while they come in batches: bounded, however many there are."""

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cache, partial
from typing import Final

import numpy as np
import polars as pl

from ..distribution import Distribution, Sketch, exactly, thinned
from ..quantities import CATEGORIES, NUMBERS
from ..scores import COUNTS
from ..statistics import Moments, Statistics, moments, statistics_of_all
from ..summary import Summary
from ..tallies import Tallies, tallied, tallied_together, tallies
from .keys import LOG

POOLED: Final = (*LOG, "missing", "reasons", *CATEGORIES, *COUNTS, *(quantity.column for quantity in NUMBERS))
"""Columns that a pool takes in."""


@dataclass(frozen=True)
class GroupExtent:
    """How long the logs of a group are together; nothing where it holds but some frames of them.

    ``span_s`` are the seconds from first to last frame of each segment, ``longest_gap_s`` the longest time between two
    frames of one.
    """

    segments: int = 0
    span_s: float = 0.0
    longest_gap_s: float = 0.0


class Pool:
    """The frames of a group so far: counts, sums, and distributions of at most so many points."""

    def __init__(self, points: int) -> None:
        self._points = points
        self._frames = 0
        self._logs: set[tuple[str, ...]] = set()
        self._tallies: list[Tallies] = []
        self._moments: dict[str, list[Moments]] = {}
        self._sketches: dict[str, Sketch] = {}

    def limit(self, points: int) -> None:
        """Keep fewer points of each distribution."""
        if points < self._points:
            self._points = points
            for sketch in self._sketches.values():
                sketch.limit(points)

    def add(self, frames: pl.DataFrame, threads: Executor) -> None:
        """Take in some frames of at least one row, with the columns of ``POOLED``."""
        self._frames += frames.height
        self._logs.update(frames.select(LOG).unique().iter_rows())
        self._tallies.append(tallied(frames.select(_tallies()).row(0, named=True)))
        names = [quantity.column for quantity in NUMBERS]
        parts = threads.map(partial(_part, points=self._points), (frames[name] for name in names))
        for name, found in zip(names, parts, strict=True):
            if found is not None:
                self._moments.setdefault(name, []).append(found[0])
                self._sketches.setdefault(name, Sketch(self._points)).add(found[1])

    def summary(self, name: str, extent: GroupExtent) -> Summary:
        """All of it, under a name; what needs neighbouring frames or other tables is left out."""
        return Summary(
            **vars(tallied_together(self._tallies)),
            name=name,
            frames=self._frames,
            runs=len(self._logs),
            log_ids=tuple(dict.fromkeys(log_id for log_id, _ in sorted(self._logs))),
            configs=tuple(dict.fromkeys(config for _, config in sorted(self._logs))),
            versions=(),
            **vars(extent),
            statistics=dict(self._statistics()),
            correlations={},
            consistency={},
            worst={},
        )

    def _statistics(self) -> Iterator[tuple[str, Statistics]]:
        for quantity in NUMBERS:
            if quantity.column in self._sketches:
                distribution = self._sketches[quantity.column].distribution()
                yield quantity.column, statistics_of_all(self._moments[quantity.column], distribution)


@cache
def _tallies() -> list[pl.Expr]:
    return tallies()


def _part(column: pl.Series, points: int) -> tuple[Moments, Distribution] | None:
    """What is kept of a batch's values; None where there are none."""
    values = np.sort(column.drop_nulls().to_numpy())
    if not len(values):
        return None
    whole = exactly(values)
    return moments(values), thinned(whole, points)
