"""How far runs' paths are from the true ones, and both as files for other tools."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from roadperc_stream.errors import TableError
from roadperc_stream.terminal import console_for, print_lines

from .options import Alignment, DeltaUnit
from .runs import Run, find_runs
from .trajectories import tables
from .trajectories.columns import read_poses
from .trajectories.errors import Delta
from .trajectories.files import export_kitti, export_tum
from .trajectories.judgement import Judgement, judge
from .trajectories.poses import RunPoses


@dataclass(frozen=True)
class Options:
    """How paths are compared, and the folders their files go to."""

    alignment: Alignment | None
    delta: float
    delta_unit: DeltaUnit
    tum: Path | None
    kitti: Path | None


def print_trajectories(arguments: Sequence[str], options: Options) -> None:
    """Print the errors of runs' paths, and export them.

    Args:
        arguments: tables, logs, folders or globs.
        options: how.

    Raises:
        TableError: there is no such run, or none with a path.
    """
    _print_runs(find_runs(arguments), options)


def _print_runs(runs: Sequence[Run], options: Options) -> None:
    """Every run's figures; a run that has none is named, and is an error where nothing else came of the command."""
    judged: list[Judgement] = []
    refused: list[TableError] = []
    exported = 0
    for item in runs:
        try:
            poses = read_poses(item)
            exported += _export(poses, options)
            judged.append(judge(poses, options.alignment, Delta(options.delta, options.delta_unit)))
        except TableError as error:
            refused.append(error)
    if not judged and not exported:
        raise refused[0]
    console = console_for(sys.stdout)
    print_lines(console, *(str(reason) for reason in refused), unbroken=True)
    if len(judged) == 1:
        print_lines(console, *_one(judged[0]), unbroken=True)
    elif judged:
        print_lines(console, *_several(judged), unbroken=True)


def _export(poses: RunPoses, options: Options) -> bool:
    """Write the files that were asked for; whether there were any."""
    if options.tum:
        export_tum(options.tum, poses)
    if options.kitti:
        export_kitti(options.kitti, poses)
    return bool(options.tum or options.kitti)


def _one(judgement: Judgement) -> list[str | Table]:
    facts = (tables.coverage(judgement), tables.alignment(judgement), tables.without_scale(judgement))
    figures = (tables.errors(judgement), "", tables.stretches(judgement), tables.lengths(judgement))
    return [*filter(None, facts), "", *figures]


def _several(judged: Sequence[Judgement]) -> list[str | Table]:
    notes = [f"{judgement.run.name}: {note}" for judgement in judged if (note := tables.without_scale(judgement))]
    return [tables.runs(judged), "", tables.side_by_side(judged), *notes]
