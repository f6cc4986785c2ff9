"""Which run of the candidate belongs to which of the reference, and which frame to which."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.system.files import METRICS_SUFFIX

from ..drives import find_drives
from ..runs import Run, collect
from ..scan import rows_of, segment

STAMP: Final = "stamp_ns"
NTH: Final = "nth of stamp"
WITHIN: Final = "pairs within"
KEY: Final = (WITHIN, STAMP, NTH)


@dataclass(frozen=True)
class LoggedRun:
    """A run with the log it was made from, how many segments that has, and its name below the folder it was found in.

    Of a drive in parts ``log_id`` names the log of each, and the name is the first part's.
    """

    run: Run
    log_id: str
    segments: int
    relative: str


@dataclass(frozen=True)
class RunPair:
    """One run of the reference and the candidate's of the same log."""

    reference: LoggedRun
    candidate: LoggedRun

    @property
    def name(self) -> str:
        """What to call the two."""
        return self.reference.relative

    @property
    def columns(self) -> frozenset[str]:
        """Those of either table."""
        return self.reference.run.columns | self.candidate.run.columns

    @property
    def by_one_digest(self) -> bool:
        """Whether the names of the logs say if they are one: earlier versions made them by another algorithm."""
        return self.reference.run.digest_algorithm == self.candidate.run.digest_algorithm

    @property
    def by_segment(self) -> bool:
        """Whether frames pair within segments: one segment's stamps may be another's too.

        Where the runs do not have as many segments, nothing says which belong together, and stamps alone decide.
        """
        return self.reference.segments == self.candidate.segments > 1


@dataclass(frozen=True)
class Pairing:
    """All pairs, and the runs without a partner."""

    pairs: tuple[RunPair, ...]
    missing: tuple[LoggedRun, ...]
    added: tuple[LoggedRun, ...]


def logged_runs(argument: str) -> tuple[LoggedRun, ...]:
    """The runs an argument means.

    Raises:
        TableError: none, one that is not a metrics table, or one without frames or of several logs.
    """
    return tuple(_logged(run, Path(argument)) for run in find_drives([argument]).runs)


def pair_runs(reference: Sequence[LoggedRun], candidate: Sequence[LoggedRun], other_log: bool) -> Pairing:
    """Pair by log where each side has one run of it, else by name; two single runs are a pair in any case.

    Args:
        reference: runs to compare with.
        candidate: runs to compare.
        other_log: whether a pair may be of two different logs.

    Raises:
        TableError: nothing pairs, or a pair is of two logs, as far as their names say, and ``other_log`` does not
            allow it.
    """
    if len(reference) == len(candidate) == 1:
        partners = {reference[0].relative: candidate[0]}
    else:
        ours, theirs = _only_of_their_log(reference), _only_of_their_log(candidate)
        partners = {ours[log_id].relative: theirs[log_id] for log_id in ours if log_id in theirs}
        paired = {item.relative for item in partners.values()}
        by_name = {item.relative: item for item in candidate if item.relative not in paired}
        partners = {name: by_name[name] for item in reference if (name := item.relative) in by_name} | partners
    pairs = tuple(RunPair(item, partners[item.relative]) for item in reference if item.relative in partners)
    if not pairs:
        raise TableError(f"{candidate[0].run.path}: no run here has the log or the name of one in the reference")
    if not other_log:
        _require_same_log(pairs)
    paired = {pair.candidate.relative for pair in pairs}
    missing = tuple(item for item in reference if item.relative not in partners)
    return Pairing(pairs, missing, tuple(item for item in candidate if item.relative not in paired))


def numbered(frame: pl.LazyFrame, item: LoggedRun, by_segment: bool) -> pl.LazyFrame:
    """The same rows with what tells frames of equal stamps apart: their segment, and ``nth of stamp`` within it.

    Args:
        frame: rows of the run.
        item: the run.
        by_segment: whether frames pair by its segments, counted from 1; else stamps alone decide.
    """
    segments = segment(item.run.columns).rank("dense").cast(pl.Int64) if by_segment else pl.lit(0, pl.Int64)
    within = frame.with_columns(segments.alias(WITHIN))
    return within.with_columns(pl.int_range(pl.len()).over(WITHIN, STAMP).alias(NTH))


def _logged(run: Run, argument: Path) -> LoggedRun:
    if not run.frames:
        raise TableError(f"{run.why_empty}, so there is nothing to compare")
    log_ids = "+".join(_log_id(table) for table in run.tables if table.rows)
    below = run.path.relative_to(argument).as_posix().removesuffix(METRICS_SUFFIX) if argument.is_dir() else run.name
    return logged(run, log_ids, below)


def logged(run: Run, log_id: str, relative: str) -> LoggedRun:
    """A run of one row at least, of a log that is known.

    Args:
        run: the run.
        log_id: digest of the log.
        relative: what the run is called among those of its side.

    Raises:
        TableError: its data cannot be read.
    """
    rows = rows_of(run).select(segment(run.columns).n_unique().alias("segments"))
    return LoggedRun(run, log_id, collect(rows, run.source_name).item(), relative)


def _log_id(run: Run) -> str:
    log_ids = pl.scan_parquet(run.path, glob=False).select(pl.col("log_id").cast(pl.String).unique())
    found = collect(log_ids, str(run.path))
    names = sorted(found["log_id"])
    if len(names) > 1:
        raise TableError(f"{run.path}: holds {len(names)} logs ({', '.join(names[:3])}), expected the frames of one")
    return str(names[0])


def _only_of_their_log(runs: Sequence[LoggedRun]) -> dict[str, LoggedRun]:
    """By the logs of which there is exactly one run."""
    counts = Counter(item.log_id for item in runs)
    return {item.log_id: item for item in runs if counts[item.log_id] == 1}


def _require_same_log(pairs: Iterable[RunPair]) -> None:
    for pair in pairs:
        ours, theirs = pair.reference, pair.candidate
        if ours.log_id != theirs.log_id and pair.by_one_digest:
            raise TableError(
                f"{theirs.run.path}: is of log {theirs.log_id}, expected {ours.log_id} as in {ours.run.path}; "
                "--other-log compares two inputs by their stamps"
            )
