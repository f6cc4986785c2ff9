"""A run against a reference, field by field and metric by metric; the reference may be kept and updated."""

import argparse
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from roadperc_stream.errors import RegressionError, TableError
from roadperc_stream.output.terminal import console_for
from roadperc_stream.system.files import METRICS_SUFFIX, TABLE_SUFFIX, completing
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import print_line

from .comparison.agreement import same_but_for_times
from .comparison.comparing import Comparison, compare_runs
from .comparison.display import print_comparison
from .comparison.pairing import Pairing, RunPair, logged_runs, pair_runs
from .dataset.pairs import in_a_folder, runs_of_configs
from .dataset.place import Dataset
from .options import Rules
from .quantities import listed
from .runs import Run

Copy = tuple[Path, Path]
"""A table of the candidate, and where it goes in the reference."""


def _require_updatable(reference: str) -> None:
    """Check that an argument names tables that can be replaced.

    Raises:
        TableError: it is a log, which a new table would no longer fit, or a glob.
    """
    path = Path(reference)
    if path.suffix == ".mcap":
        raise TableError(f"{reference}: is a log; to update a reference, keep its table or a folder of tables")
    if any(sign in reference for sign in "*?[") and not path.exists():
        raise TableError(f"{reference}: expected a folder or a table to update, found a glob")


def _is_new(reference: str) -> bool:
    """Whether there is no reference yet: nothing of that name, or a folder without tables."""
    path = Path(reference)
    return not path.exists() or (path.is_dir() and not any(path.rglob(f"*{METRICS_SUFFIX}")))


def _first_copies(reference: str, candidate: Sequence[Run]) -> list[Copy]:
    """Copies that make a reference of a candidate.

    Raises:
        TableError: several tables are to become one file.
    """
    path = Path(reference)
    if path.suffix != TABLE_SUFFIX:
        return [copy for run in candidate for copy in _into_folder(path, run)]
    tables = sum(len(run.tables) for run in candidate)
    if tables > 1:
        raise TableError(f"{reference}: is to hold {tables} tables, expected the name of a folder")
    return [(candidate[0].path, path)]


def _update_copies(reference: str, pairing: Pairing) -> list[Copy]:
    """Copies that bring a reference up to date: tables whose results differ, and those it has none of.

    Raises:
        TableError: a drive of one is in more parts than the other's.
    """
    differing = (pair for pair in pairing.pairs if not same_but_for_times(pair))
    changed = [copy for pair in differing for copy in _replacements(pair)]
    path = Path(reference)
    added = pairing.added if path.is_dir() else ()
    return [*changed, *(copy for run in added for copy in _into_folder(path, run))]


def _replacements(pair: RunPair) -> Iterator[Copy]:
    ours, theirs = pair.reference.tables, pair.candidate.tables
    if len(ours) != len(theirs):
        raise TableError(
            f"{pair.candidate.source_name}: a drive of {len(theirs)} tables cannot replace one of {len(ours)}; "
            "expected the same parts, or a new reference"
        )
    return ((new.path, old.path) for old, new in zip(ours, theirs, strict=True))


def _into_folder(folder: Path, run: Run) -> Iterator[Copy]:
    """The tables under their names below the candidate's folder; those of a drive's parts next to the first."""
    first, *others = run.tables
    target = folder / f"{run.name}{METRICS_SUFFIX}"
    yield first.path, target
    yield from ((part.path, target.with_name(f"{part.name.replace('/', '-')}{METRICS_SUFFIX}")) for part in others)


def compare(arguments: argparse.Namespace) -> None:
    """Print where two runs part, and whether the second is worse.

    Raises:
        RegressionError: it is, or a field differs where none may.
        RoadpercError: the runs cannot be read, or do not belong together.
    """
    if arguments.candidate is None:
        with in_a_folder(Dataset(arguments.reference)) as dataset:
            reference, candidate = runs_of_configs(dataset, arguments.config)
            found = _compared(pair_runs(reference, candidate, arguments.other_log), None, arguments)
        _require_no_regression(found, arguments.exact)
        return
    candidate = logged_runs(arguments.candidate)
    if arguments.update_reference:
        _require_updatable(arguments.reference)
        if _is_new(arguments.reference):
            _update(_first_copies(arguments.reference, candidate))
            return
    pairing = pair_runs(logged_runs(arguments.reference), candidate, arguments.other_log)
    paths = Path(arguments.reference), Path(arguments.candidate)
    found = _compared(pairing, paths if {path.suffix for path in paths} == {".mcap"} else None, arguments)
    if arguments.update_reference:
        _update(_update_copies(arguments.reference, pairing))
    else:
        _require_no_regression(found, arguments.exact)


def _compared(pairing: Pairing, logs: tuple[Path, Path] | None, arguments: argparse.Namespace) -> Comparison:
    """The comparison, printed; of two logs that were named also that of their results."""
    rules = Rules(tuple(arguments.ignore), tuple(arguments.tolerance), tuple(arguments.allow))
    found = compare_runs(pairing, logs, rules)
    with optional_output():
        print_comparison(console_for(sys.stdout), found, all_fields=arguments.exact)
    return found


def _update(copies: Sequence[Copy]) -> None:
    """Copy each table, which appears under its name only when complete, and say so."""
    for source, target in copies:
        with completing(target) as temporary:
            shutil.copyfile(source, temporary)
    for source, target in copies:
        print_line(f"reference: {target} is now {source}")
    if not copies:
        print("reference: nothing to replace, its results are the same")


def _require_no_regression(found: Comparison, exact: bool) -> None:
    if found.regressions:
        raise RegressionError(f"worse than the reference: {listed(found.regressions)}")
    if exact and found.differences:
        raise RegressionError(f"differs from the reference: {listed(found.differences)}")
