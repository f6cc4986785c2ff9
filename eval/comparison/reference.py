"""A reference run that is kept, in a repository maybe: only its metrics tables are needed."""

import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from roadperc_stream.core.files import METRICS_SUFFIX, TABLE_SUFFIX, completing
from roadperc_stream.errors import TableError

from .pairing import LoggedRun, Pairing, RunPair
from .tables import same_but_for_times


@dataclass(frozen=True)
class Copy:
    """A table to be copied from the candidate into the reference."""

    source: Path
    target: Path


def require_updatable(reference: str) -> None:
    """Check that an argument names tables that can be replaced.

    Raises:
        TableError: it is a log, which a new table would no longer fit, or a glob.
    """
    path = Path(reference)
    if path.suffix == ".mcap":
        raise TableError(f"{reference}: is a log; to update a reference, keep its table or a folder of tables")
    if any(sign in reference for sign in "*?[") and not path.exists():
        raise TableError(f"{reference}: expected a folder or a table to update, found a glob")


def is_new(reference: str) -> bool:
    """Whether there is no reference yet: nothing of that name, or a folder without tables."""
    path = Path(reference)
    return not path.exists() or (path.is_dir() and not any(path.rglob(f"*{METRICS_SUFFIX}")))


def first_copies(reference: str, candidate: Iterable[LoggedRun]) -> tuple[Copy, ...]:
    """Copies that make a reference of a candidate.

    Raises:
        TableError: several tables are to become one file.
    """
    runs, path = list(candidate), Path(reference)
    if path.suffix != TABLE_SUFFIX:
        return tuple(copy for item in runs for copy in _into_folder(path, item))
    tables = sum(len(item.run.tables) for item in runs)
    if tables > 1:
        raise TableError(f"{reference}: is to hold {tables} tables, expected the name of a folder")
    return (Copy(runs[0].run.path, path),)


def update_copies(reference: str, pairing: Pairing) -> tuple[Copy, ...]:
    """Copies that bring a reference up to date: tables whose results differ, and those it has none of.

    Raises:
        TableError: a drive of one is in more parts than the other's.
    """
    differing = (pair for pair in pairing.pairs if not same_but_for_times(pair))
    changed = tuple(copy for pair in differing for copy in _replacements(pair))
    path = Path(reference)
    if not path.is_dir():
        return changed
    return (*changed, *(copy for item in pairing.added for copy in _into_folder(path, item)))


def carry_out(copies: Iterable[Copy]) -> None:
    """Copy each table; it appears under its name only when complete.

    Raises:
        TargetError: a table cannot be copied.
    """
    for copy in copies:
        with completing(copy.target) as temporary:
            shutil.copyfile(copy.source, temporary)


def _replacements(pair: RunPair) -> Iterator[Copy]:
    ours, theirs = pair.reference.run.tables, pair.candidate.run.tables
    if len(ours) != len(theirs):
        raise TableError(
            f"{pair.candidate.run.source_name}: a drive of {len(theirs)} tables cannot replace one of {len(ours)}; "
            "expected the same parts, or a new reference"
        )
    return (Copy(new.path, old.path) for old, new in zip(ours, theirs, strict=True))


def _into_folder(folder: Path, item: LoggedRun) -> Iterator[Copy]:
    """The tables under their names below the candidate's folder; those of a drive's parts next to the first."""
    first, *others = item.run.tables
    target = folder / f"{item.relative}{METRICS_SUFFIX}"
    yield Copy(first.path, target)
    yield from (Copy(part.path, target.with_name(f"{part.name.replace('/', '-')}{METRICS_SUFFIX}")) for part in others)
