"""``roadperc-trajectory``: how far a run's path is from the true one, and both as files for other tools."""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

from roadperc_stream import __version__
from roadperc_stream.command import run
from roadperc_stream.errors import TableError
from roadperc_stream.terminal import console_for, print_lines, print_parts
from roadperc_stream.text_table import TextTable

from .names import legend, name_columns, short_names
from .runs import Run, find_runs
from .trajectories import tables
from .trajectories.alignment import Alignment
from .trajectories.columns import read_poses
from .trajectories.errors import Delta
from .trajectories.evaluation import Evaluation, evaluate
from .trajectories.files import export_kitti, export_tum
from .trajectories.poses import RunPoses

_DESCRIPTION = """\
Compare the poses a run estimated with the true ones.

ATE is the distance between places after alignment; RPE what is left of the motion between two poses when the true one
is undone, over all pairs --delta apart (metres: along the aligned estimate, within a tenth); KITTI's errors are over
stretches of 100 to 800 m of the true path, or of 5 to 50 m where none of 100 m fits. Frames without an estimated or a
true pose, and lost ones, are left out and counted. A monocular run without scale is aligned by Sim(3).

TUM files (NAME.est.tum, NAME.true.tum) hold the frames that are evaluated, each as `timestamp x y z qx qy qz qw`; KITTI
files (NAME.est.kitti, NAME.true.kitti) the same frames, against the first. Both hold the ego frame (x forward, y left,
z up, on the road), where KITTI's own files hold the left camera's: compare them with each other, not with KITTI's.
Without truth there is only NAME.est.
"""
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/sample.mcap
  roadperc-trajectory runs/sample.mcap                          from the table next to the log
  roadperc-trajectory runs/ --align sim3                        a row a run, path shapes only
  roadperc-trajectory runs/sample.mcap --delta 5 --delta-unit metres --export-tum paths/
  evo_ape tum paths/sample.true.tum paths/sample.est.tum -a     says the same ATE
"""


@dataclass(frozen=True)
class _Options:
    alignment: Alignment | None
    delta: Delta
    tum: Path | None
    kitti: Path | None


def main(argv: list[str] | None = None) -> int:
    """``roadperc-trajectory``: print the errors of runs' paths, and export them."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.delta_unit == "frames" and arguments.delta != int(arguments.delta):
        parser.error(f"argument --delta: {arguments.delta:g}: expected whole frames, or --delta-unit metres")
    delta = Delta(arguments.delta, arguments.delta_unit)
    options = _Options(arguments.align, delta, arguments.export_tum, arguments.export_kitti)
    return run(lambda: _print_runs(find_runs(arguments.runs), options))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-trajectory",
        description=_DESCRIPTION,
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("runs", metavar="RUN", nargs="+", help="OUT.metrics.parquet, the OUT.mcap next to it, a folder, or a glob")
    add(
        "--align",
        choices=get_args(Alignment),
        help="how the estimate is laid over the truth: turned and shifted, scaled too, first pose on first pose, or "
        "not at all (default se3; sim3 where the run has no scale)",
    )
    add("--delta", metavar="N", type=_positive, default=1.0, help="how far apart the poses of a pair are (default 1)")
    add("--delta-unit", choices=("frames", "metres"), default="frames", help="unit of N (default frames)")
    add("--export-tum", metavar="DIR", type=Path, help="write TUM files into this folder; replaces earlier ones")
    add("--export-kitti", metavar="DIR", type=Path, help="write KITTI files into this folder; replaces earlier ones")
    add("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _positive(text: str) -> float:
    number = float(text)
    if not (math.isfinite(number) and number > 0):
        raise argparse.ArgumentTypeError(f"{text}: expected more than 0")
    return number


def _print_runs(runs: Sequence[Run], options: _Options) -> None:
    """Every run's figures; a run that has none is named, and is an error where nothing else came of the command."""
    evaluated: list[Evaluation] = []
    refused: list[TableError] = []
    exported = 0
    for item in runs:
        try:
            poses = read_poses(item)
            exported += _export(poses, options)
            evaluated.append(evaluate(poses, options.alignment, options.delta))
        except TableError as error:
            refused.append(error)
    if not evaluated and not exported:
        raise refused[0]
    console = console_for(sys.stdout)
    print_lines(console, *(str(reason) for reason in refused), unbroken=True)
    if len(evaluated) == 1:
        print_parts(console, *_one(evaluated[0]))
    elif evaluated:
        print_parts(console, *_several(evaluated, name_columns(console)))


def _export(poses: RunPoses, options: _Options) -> bool:
    """Write the files that were asked for; whether there were any."""
    if options.tum:
        export_tum(options.tum, poses)
    if options.kitti:
        export_kitti(options.kitti, poses)
    return bool(options.tum or options.kitti)


def _one(evaluation: Evaluation) -> list[str | TextTable]:
    facts = (tables.coverage(evaluation), tables.alignment(evaluation), tables.without_scale(evaluation))
    return [*filter(None, facts), tables.errors(evaluation), tables.stretches(evaluation)]


def _several(evaluated: Sequence[Evaluation], columns: int) -> list[str | TextTable]:
    names = short_names([item.run.name for item in evaluated], columns)
    notes = [f"{item.run.name}: {note}" for item in evaluated if (note := tables.without_scale(item))]
    overview = replace(tables.runs(evaluated, names), notes=tuple(legend(names)))
    return [f"{len(evaluated)} runs", overview, tables.side_by_side(evaluated, names), *notes]
