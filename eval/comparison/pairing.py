"""Which run of the candidate belongs to which of the reference, and which frame to which."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.system.files import METRICS_SUFFIX

from ..drives import find_drives
from ..runs import Run, collect
from ..scan import rows_of, segment

STAMP: Final = "stamp_ns"
_NTH: Final = "nth of stamp"
_WITHIN: Final = "pairs within"
KEY: Final = (_WITHIN, STAMP, _NTH)


@dataclass(frozen=True)
class RunPair:
    """One run of the reference and the candidate's of the same log."""

    reference: Run
    candidate: Run

    @property
    def name(self) -> str:
        """What to call the two."""
        return self.reference.name

    @property
    def columns(self) -> frozenset[str]:
        """Those of either table."""
        return self.reference.columns | self.candidate.columns

    @property
    def by_one_digest(self) -> bool:
        """Whether the names of the logs say if they are one: earlier versions made them by another algorithm."""
        return self.reference.digest_algorithm == self.candidate.digest_algorithm

    @cached_property
    def by_segment(self) -> bool:
        """Whether frames pair within segments: one segment's stamps may be another's too.

        Where the runs do not have as many segments, nothing says which belong together, and stamps alone decide.
        """
        ours, theirs = (
            collect(rows_of(run).select(segment(run.columns).n_unique()), run.source_name).item()
            for run in (self.reference, self.candidate)
        )
        return bool(ours == theirs > 1)


@dataclass(frozen=True)
class Pairing:
    """All pairs, and the runs without a partner."""

    pairs: tuple[RunPair, ...]
    missing: tuple[Run, ...]
    added: tuple[Run, ...]


def logged_runs(argument: str) -> tuple[Run, ...]:
    """The runs an argument means, named as below its folder, each with the log it was made from.

    Raises:
        TableError: none, one that is not a metrics table, or one without frames or of several logs.
    """
    return tuple(_logged(run, Path(argument)) for run in find_drives([argument]).runs)


def pair_runs(reference: Sequence[Run], candidate: Sequence[Run], other_log: bool) -> Pairing:
    """Pair by log where each side has one run of it, else by name; two single runs are a pair in any case.

    The runs are as ``logged_runs`` gives them; ``other_log`` allows pairs of two different logs.

    Raises:
        TableError: nothing pairs, or a pair is of two logs, as far as their names say, and ``other_log`` does not
            allow it.
    """
    if len(reference) == len(candidate) == 1:
        partners = {reference[0].name: candidate[0]}
    else:
        ours, theirs = _only_of_their_log(reference), _only_of_their_log(candidate)
        by_log = {ours[log_id].name: theirs[log_id] for log_id in ours if log_id in theirs}
        taken = {run.name for run in by_log.values()}
        partners = {run.name: run for run in candidate if run.name not in taken} | by_log
    pairs = tuple(RunPair(run, partners[run.name]) for run in reference if run.name in partners)
    if not pairs:
        raise TableError(f"{candidate[0].path}: no run here has the log or the name of one in the reference")
    if not other_log:
        _require_same_log(pairs)
    paired = {pair.candidate.name for pair in pairs}
    missing = tuple(run for run in reference if run.name not in partners)
    return Pairing(pairs, missing, tuple(run for run in candidate if run.name not in paired))


def numbered(frame: pl.LazyFrame, run: Run, by_segment: bool) -> pl.LazyFrame:
    """The rows of a run with what tells frames of equal stamps apart: their segment, and their number within it.

    Segments count from 1; without ``by_segment`` all are 0, so that stamps alone decide.
    """
    segments = segment(run.columns).rank("dense").cast(pl.Int64) if by_segment else pl.lit(0, pl.Int64)
    within = frame.with_columns(segments.alias(_WITHIN))
    return within.with_columns(pl.int_range(pl.len()).over(_WITHIN, STAMP).alias(_NTH))


def _logged(run: Run, argument: Path) -> Run:
    if not run.frames:
        raise TableError(f"{run.why_empty}, so there is nothing to compare")
    log_ids = "+".join(_log_id(table) for table in run.tables if table.rows)
    below = run.path.relative_to(argument).as_posix().removesuffix(METRICS_SUFFIX) if argument.is_dir() else run.name
    return replace(run, log_id=log_ids, name=below)


def _log_id(run: Run) -> str:
    log_ids = pl.scan_parquet(run.path, glob=False).select(pl.col("log_id").cast(pl.String).unique())
    names = sorted(collect(log_ids, str(run.path))["log_id"])
    if len(names) > 1:
        raise TableError(f"{run.path}: holds {len(names)} logs ({', '.join(names[:3])}), expected the frames of one")
    return str(names[0])


def _only_of_their_log(runs: Sequence[Run]) -> dict[str, Run]:
    """By the logs of which there is exactly one run."""
    counts = Counter(run.log_id for run in runs)
    return {run.log_id: run for run in runs if counts[run.log_id] == 1}


def _require_same_log(pairs: Iterable[RunPair]) -> None:
    for pair in pairs:
        ours, theirs = pair.reference, pair.candidate
        if ours.log_id != theirs.log_id and pair.by_one_digest:
            raise TableError(
                f"{theirs.path}: is of log {theirs.log_id}, expected {ours.log_id} as in {ours.path}; "
                "--other-log compares two inputs by their stamps"
            )
