"""The worst logs of a dataset, and the frames to look at in them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float
from roadperc_stream.schemas.columns import RATIO

from ..report_columns import COVERED, RANKED, Quantity, ranked
from .sources import Frames, Numbers
from .summaries import Groups, WorstFrame, frame_at, worst_frames

Known = NDArray[np.bool_]
"""(N,) whether a value is known."""
_OUTPUTS = {column: output for output, column in COVERED.items()}


@dataclass(frozen=True)
class WorstLog:
    """A run, the mean of its judged values, the share of its frames with a value, and its worst frames."""

    run: int
    mean: float
    share: float
    frames: tuple[WorstFrame, ...]


@dataclass(frozen=True)
class LeastCovered:
    """A run, the share of its frames with an output, and both ends of the longest stretch of frames without it."""

    run: int
    share: float
    first: WorstFrame
    last: WorstFrame


@dataclass
class WorstLogs:
    """The ``number`` worst logs by each quantity and by the coverage of each output; it is fed column by column.

    Errors against truth rank the logs, or suspect quantities without truth. Logs with only perfect frames are left out,
    and so are outputs that a configuration never has. Each log is listed once, under its worst configuration.
    """

    frames: Frames
    number: int
    by_column: dict[str, list[WorstLog]] = field(default_factory=dict)
    by_output: dict[str, list[LeastCovered]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Number the runs."""
        runs = np.arange(self.frames.runs.height)
        self._of_runs = Groups(list(map(str, runs)), self.frames.run, runs)
        self._starts = np.flatnonzero(np.diff(self.frames.run, prepend=-1))
        self._counts = self._sums(np.ones(len(self.frames.run), bool))
        names = self.frames.runs.select("log_id" if "log_id" in self.frames.runs.columns else "log", "config")
        self._logs = names.to_series().to_list()
        self._places = names.select(pl.struct(pl.all()).rank("ordinal")).to_series().to_numpy()

    @property
    def by_quantity(self) -> dict[Quantity, list[WorstLog]]:
        """The logs by each quantity that ranks them."""
        found = {quantity: self.by_column[quantity.column] for quantity in ranked(self.by_column)}
        return {quantity: logs for quantity, logs in found.items() if logs}

    @property
    def covered(self) -> dict[str, list[LeastCovered]]:
        """The logs by each output, in the order of the outputs."""
        return {output: self.by_output[output] for output in COVERED if output in self.by_output}

    def add(self, column: str, values: Float) -> None:
        """Rank the logs by the (N,) values of a column."""
        known = np.isfinite(values)
        valued = self._sums(known)
        if column in RANKED and valued.any():
            self.by_column[column] = list(self._ranked(RANKED[column], values, known, valued))
        if column in _OUTPUTS:
            uncovered = list(self._uncovered(known, valued))
            self.by_output |= {_OUTPUTS[column]: uncovered} if uncovered else {}

    def _sums(self, values: Float | Known) -> Float:
        """The sum of (N,) values over the frames of each run, whose frames mostly follow each other."""
        sums = np.add.reduceat(values, self._starts, dtype=float)
        return np.bincount(self.frames.run[self._starts], sums, self.frames.runs.height).astype(float)

    def _ranked(self, quantity: Quantity, values: Float, known: Known, valued: Float) -> Iterator[WorstLog]:
        high = quantity.better == "high"
        judged = np.where(known, values, 0.0)
        sums = self._sums(judged if high else np.abs(judged, out=judged))
        del judged  # as large as a column
        means = np.divide(sums, valued, out=np.full(len(valued), np.nan), where=valued > 0)
        bad, best = (-means, -1.0 if quantity.unit == RATIO else -math.inf) if high else (means, 0.0)
        for run in self._each_once(np.flatnonzero(bad > best), -bad):
            at = self._of_runs.frames[run]
            worst = worst_frames(self.frames, quantity, values[at], at, self.number)
            yield WorstLog(run, float(means[run]), float(valued[run] / self._counts[run]), worst)

    def _uncovered(self, known: Known, valued: Float) -> Iterator[LeastCovered]:
        configs = self.frames.runs["config"]
        enabled = configs.is_in(configs.filter(valued > 0).unique().implode()).to_numpy()
        shares = valued / self._counts
        for run in self._each_once(np.flatnonzero(enabled & (shares < 1)), shares):
            at = self._of_runs.frames[run]
            first, last = longest_without(known[at])
            yield LeastCovered(run, float(shares[run]), *(frame_at(self.frames, int(at[k])) for k in (first, last)))

    def _each_once(self, runs: Numbers, order: Float) -> Sequence[int]:
        """The first runs in ascending ``order``, each log under its first configuration only."""
        first: dict[str, int] = {}
        for run in runs[np.lexsort((self._places[runs], order[runs]))].tolist():
            first.setdefault(self._logs[run], run)
            if len(first) == self.number:
                break
        return list(first.values())


def longest_without(known: Known) -> tuple[int, int]:
    """The first and the last place of the longest stretch of (N,) that is not known, the first of equal ones."""
    edges = np.flatnonzero(np.diff(np.concatenate(([True], known, [True]))))
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest]) - 1
