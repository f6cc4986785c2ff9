"""Compares a new run with a base run, field by field and metric by metric, and updates the tables of the base."""

import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from roadperc_stream.errors import RegressionError, TableError
from roadperc_stream.output.terminal import console_for
from roadperc_stream.system.files import METRICS_SUFFIX, TABLE_SUFFIX, completing
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import listed, number, print_line

from ..criteria import effects
from ..dataset.pairs import in_a_folder, runs_of_config, runs_of_configs
from ..dataset.place import Dataset, dataset_at
from ..options import Rules
from ..results import ResultFiles
from ..runs import Run
from .comparison import compare_runs
from .fields import same_except_times
from .pairing import Pairing, logged_runs, pair_runs
from .pictures import draw_worst
from .summary import for_people, for_programs

Copy = tuple[Path, Path]
"""A table of the new run, and its place in the base."""


@dataclass(frozen=True)
class CompareOptions:
    """How to compare two sides, and what to print.

    ``configs`` are the configurations of base and new in a dataset, None for the only one. The file ``criteria`` has
    relevant effects and limits, which replace those of ``rules``. ``pictures`` is a folder for the worst frames.
    """

    configs: tuple[str | None, str | None] = (None, None)
    rules: Rules = field(default_factory=Rules)
    criteria: Path | None = None
    pictures: Path | None = None
    full: bool = False
    exact: bool = False
    other_log: bool = False
    update_reference: bool = False


def compare(base: str, new: str | None, options: CompareOptions, files: ResultFiles) -> None:
    """Print the verdict on a new run, and write it to files for other programs; without ``new`` base is a dataset.

    Raises:
        RegressionError: the new run is worse, or with ``--exact`` a field differs.
        RoadpercError: the runs cannot be read, or do not belong together.
    """
    path = Path(base)
    if new and options.update_reference:
        _require_updatable(base)
        if not path.exists() or (path.is_dir() and not any(path.rglob(f"*{METRICS_SUFFIX}"))):
            _update(_copies(path, Pairing((), (), added=logged_runs(new))))
            return
    with ExitStack() as temporary:
        if new is None:
            sides = runs_of_configs(temporary.enter_context(in_a_folder(Dataset(base))), options.configs)
        else:
            of_base = _side(base, "--base-config", options.configs[0], temporary)
            sides = of_base, _side(new, "--new-config", options.configs[1], temporary)
        pairing = pair_runs(*sides, options.other_log)
        logs = (path, Path(new)) if new and path.suffix == Path(new).suffix == ".mcap" else None
        found = compare_runs(pairing, logs, _rules(options))
        pictures, notes = draw_worst(found, options.pictures) if options.pictures else ([], [])
        replace(for_programs(found, exact=options.exact), pictures=pictures, tail=notes).write(files)
        with optional_output():
            for_people(found, full=options.full, all_fields=options.exact).print(console_for(sys.stdout))
            for line in (*(f"wrote {path}: {caption}" for caption, path in pictures), *notes):
                print_line(line)
    if options.update_reference:
        _update(_copies(path, pairing))
    elif found.regressions:
        raise RegressionError(f"worse than the base run: {listed(found.regressions)}")
    elif options.exact and found.differences:
        raise RegressionError(f"differs from the base run: {listed(found.differences)}")


def _side(argument: str, option: str, config: str | None, temporary: ExitStack) -> tuple[Run, ...]:
    """The runs of an argument: those of a configuration of a dataset, else all."""
    dataset = dataset_at(argument)
    if dataset is None:
        return logged_runs(argument)
    return runs_of_config(temporary.enter_context(in_a_folder(dataset)), option, config)


def _rules(options: CompareOptions) -> Rules:
    if options.criteria is None:
        return options.rules
    known = effects(options.criteria)
    relevant = {name: effect.relevant for name, effect in known.items() if effect.relevant is not None}
    limits = {name: effect.limit for name, effect in known.items() if effect.limit is not None}
    return replace(options.rules, relevant=relevant, limits=limits)


def _require_updatable(base: str) -> None:
    """Check that an argument names tables that can be replaced.

    Raises:
        TableError: it is a log, which would not fit a new table, or a glob.
    """
    path = Path(base)
    if path.suffix == ".mcap":
        raise TableError(f"{base}: is a log; with --update-reference pass a table or a folder of tables")
    if any(sign in base for sign in "*?[") and not path.exists():
        raise TableError(f"{base}: expected a folder or a table to update, found a glob")


def _copies(base: Path, pairing: Pairing) -> list[Copy]:
    """Copies of the tables whose results differ, and of the tables that the base lacks.

    Raises:
        TableError: a pair has different numbers of continued replays, or one table would have to hold several.
    """
    copies: list[Copy] = []
    for pair in (pair for pair in pairing.pairs if not same_except_times(pair)):
        ours, theirs = pair.base.tables, pair.new.tables
        if len(ours) != len(theirs):
            found = f"{number(len(theirs), 'table')} cannot replace {len(ours)}"
            expected = "expected as many continued replays, or another base"
            raise TableError(f"{pair.new.source_name}: {found}; {expected}")
        copies += ((new.path, old.path) for old, new in zip(ours, theirs, strict=True))
    if base.suffix != TABLE_SUFFIX:
        return [*copies, *(copy for run in pairing.added for copy in _into_folder(base, run))]
    tables = [table.path for run in pairing.added for table in run.tables]
    if not base.exists() and len(tables) > 1:
        raise TableError(f"{base}: one table cannot hold {len(tables)} tables; pass the name of a folder")
    return copies if base.exists() else [(tables[0], base)]


def _into_folder(folder: Path, run: Run) -> Iterator[Copy]:
    """The tables of a new run at their place in the base's folder; those of continued replays beside the first."""
    first, *others = run.tables
    target = folder / f"{run.name}{METRICS_SUFFIX}"
    yield first.path, target
    yield from ((later.path, target.with_name(f"{later.name.replace('/', '-')}{METRICS_SUFFIX}")) for later in others)


def _update(copies: Sequence[Copy]) -> None:
    """Copy each table through a partial file, then print a line for each."""
    for source, target in copies:
        with completing(target) as temporary:
            shutil.copyfile(source, temporary)
    for source, target in copies:
        print_line(f"base: {target} is now {source}")
    if not copies:
        print("base: unchanged, all results are equal")
