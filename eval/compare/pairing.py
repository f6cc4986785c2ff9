"""Pairs new runs with base runs, and their frames."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.system.files import METRICS_SUFFIX

from ..continued import find_joined
from ..runs import Run, collect
from ..scan import SEGMENT, rows_of

STAMP: Final = "stamp_ns"
_NTH: Final = "nth of stamp"
_WITHIN: Final = "pairs within"
KEY: Final = (_WITHIN, STAMP, _NTH)
"""Columns that pair the frames of two runs."""
NEW: Final = " of the new run"
"""Suffix of the new run's columns in a joined table."""


@dataclass(frozen=True)
class RunPair:
    """A base run and the new run of the same log."""

    base: Run
    new: Run

    @property
    def name(self) -> str:
        """Name of the pair."""
        return self.base.name

    @property
    def columns(self) -> frozenset[str]:
        """The columns of both tables."""
        return self.base.columns | self.new.columns

    @cached_property
    def by_segment(self) -> bool:
        """Whether frames pair within segments, because several segments may have the same stamps.

        Runs with different numbers of segments pair by stamp alone.
        """
        ours, theirs = (
            collect(rows_of(run).select(pl.col(SEGMENT).n_unique()), run.source_name).item()
            for run in (self.base, self.new)
        )
        return bool(ours == theirs > 1)


@dataclass(frozen=True)
class Pairing:
    """All pairs, and the runs without a partner."""

    pairs: tuple[RunPair, ...]
    missing: tuple[Run, ...]
    added: tuple[Run, ...]


def logged_runs(argument: str) -> tuple[Run, ...]:
    """The runs of an argument with their log ids; in a folder, a run's name is its path below the folder.

    Raises:
        TableError: there is no run, a file is not a metrics table, or a table has no frames or several logs.
    """
    return tuple(_logged(run, Path(argument)) for run in find_joined([argument]).runs)


def _logged(run: Run, argument: Path) -> Run:
    if not run.frames:
        raise TableError(f"{run.why_empty}; expected a table with frames")
    log_ids = []
    for path in (table.path for table in run.tables if table.rows):
        column = pl.scan_parquet(path, glob=False).select(pl.col("log_id").cast(pl.String).unique())
        found = sorted(collect(column, str(path))["log_id"])
        if len(found) > 1:
            raise TableError(f"{path}: holds {len(found)} logs ({', '.join(found[:3])}), expected the frames of one")
        log_ids += found
    below = run.path.relative_to(argument).as_posix().removesuffix(METRICS_SUFFIX) if argument.is_dir() else run.name
    return replace(run, log_id="+".join(log_ids), name=below)


def pair_runs(base: Sequence[Run], new: Sequence[Run], other_log: bool) -> Pairing:
    """Pair runs by log if each side has one run of the log, else by name. Two single runs always pair.

    The runs come from ``logged_runs``; ``other_log`` allows pairs of two different logs.

    Raises:
        TableError: nothing pairs, or a pair is of two different logs without ``other_log``.
    """
    if len(base) == len(new) == 1:
        partners = {base[0].name: new[0]}
    else:
        first, second = _single_by_log(base), _single_by_log(new)
        by_log = {first[log_id].name: second[log_id] for log_id in first if log_id in second}
        taken = {run.name for run in by_log.values()}
        partners = {run.name: run for run in new if run.name not in taken} | by_log
    pairs = tuple(RunPair(run, partners[run.name]) for run in base if run.name in partners)
    if not pairs:
        raise TableError(f"{new[0].path}: no new run has the log or the name of a base run")
    for ours, theirs in ((pair.base, pair.new) for pair in pairs):
        if ours.log_id != theirs.log_id and not other_log:
            raise TableError(
                f"{theirs.path}: is of log {theirs.log_id}, expected {ours.log_id} as in {ours.path}; "
                "pass --other-log to compare two logs by their stamps"
            )
    paired = {pair.new.name for pair in pairs}
    missing = tuple(run for run in base if run.name not in partners)
    return Pairing(pairs, missing, tuple(run for run in new if run.name not in paired))


def _single_by_log(runs: Sequence[Run]) -> dict[str, Run]:
    """Runs by log id, without the logs that have several runs."""
    counts = Counter(run.log_id for run in runs)
    return {run.log_id: run for run in runs if counts[run.log_id] == 1}


def numbered(frame: pl.LazyFrame, by_segment: bool) -> pl.LazyFrame:
    """The rows of a run with the columns ``KEY``, which distinguish frames of equal stamps.

    These are the segment, counted from 1 (without ``by_segment`` always 0), the stamp, and the frame's number among
    those of equal segment and stamp.
    """
    segments = pl.col(SEGMENT).rank("dense").cast(pl.Int64) if by_segment else pl.lit(0, pl.Int64)
    within = frame.with_columns(segments.alias(_WITHIN))
    return within.with_columns(pl.int_range(pl.len()).over(_WITHIN, STAMP).alias(_NTH))
