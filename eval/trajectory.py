"""How far runs' paths are from the true ones, and both as files for other tools."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import console_for, print_lines, print_parts
from roadperc_stream.output.text_table import TextTable

from .drives import Drives, find_drives
from .names import legend, name_columns, short_names
from .options import Alignment, DeltaUnit
from .trajectories import tables
from .trajectories.columns import read_poses
from .trajectories.errors import Delta
from .trajectories.evaluation import Evaluation, evaluate
from .trajectories.files import export_kitti, export_tum
from .trajectories.poses import RunPoses


@dataclass(frozen=True)
class TrajectoryOptions:
    """How paths are compared, and the folders their files go to."""

    alignment: Alignment | None
    delta: float
    delta_unit: DeltaUnit
    tum: Path | None
    kitti: Path | None


def print_trajectories(arguments: Sequence[str], options: TrajectoryOptions) -> None:
    """Print the errors of runs' paths, and export them.

    Args:
        arguments: tables, logs, folders or globs.
        options: how.

    Raises:
        TableError: there is no such run, or none with a path.
    """
    _print_runs(find_drives(arguments), options)


def _print_runs(found: Drives, options: TrajectoryOptions) -> None:
    """Every run's figures; a run that has none is named, and is an error where nothing else came of the command."""
    evaluated: list[Evaluation] = []
    refused: list[TableError] = []
    exported = 0
    for item in found.runs:
        try:
            poses = read_poses(item)
            exported += _export(poses, options)
            evaluated.append(evaluate(poses, options.alignment, Delta(options.delta, options.delta_unit)))
        except TableError as error:
            refused.append(error)
    if not evaluated and not exported:
        raise refused[0]
    console = console_for(sys.stdout)
    print_lines(console, *found.notes, *(str(reason) for reason in refused), unbroken=True)
    if len(evaluated) == 1:
        print_parts(console, *_one(evaluated[0]))
    elif evaluated:
        print_parts(console, *_several(evaluated, name_columns(console)))


def _export(poses: RunPoses, options: TrajectoryOptions) -> bool:
    """Write the files that were asked for; whether there were any."""
    if options.tum:
        export_tum(options.tum, poses)
    if options.kitti:
        export_kitti(options.kitti, poses)
    return bool(options.tum or options.kitti)


def _one(evaluation: Evaluation) -> list[str | TextTable]:
    about = tables.alignment(evaluation), *evaluation.left_out, tables.without_scale(evaluation)
    facts = (*tables.coverage(evaluation), *about)
    return [*filter(None, facts), tables.errors(evaluation), tables.stretches(evaluation)]


def _notes(evaluation: Evaluation) -> Iterator[str]:
    """What there is to say of a run's figures, without its alignment."""
    yield from filter(None, (tables.segments(evaluation), *evaluation.left_out, tables.without_scale(evaluation)))


def _several(evaluated: Sequence[Evaluation], columns: int) -> list[str | TextTable]:
    names = short_names([item.run.name for item in evaluated], columns)
    notes = [f"{item.run.name}: {note}" for item in evaluated for note in _notes(item)]
    overview = replace(tables.runs(evaluated, names), notes=tuple(legend(names)))
    return [f"{len(evaluated)} runs", overview, tables.side_by_side(evaluated, names), *notes]
