"""``roadperc-trajectory``: how far a run's path is from the true one, and both as files for other tools."""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from rich.table import Table

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import run
from roadperc_stream.cli.terminal import console_for, print_lines
from roadperc_stream.errors import TableError

from .runs import Run, find_runs
from .trajectories import tables
from .trajectories.alignment import Alignment
from .trajectories.columns import read_poses
from .trajectories.errors import Delta
from .trajectories.files import export_kitti, export_tum
from .trajectories.judgement import Judgement, judge
from .trajectories.poses import RunPoses

_DESCRIPTION = """\
Hold the poses a run estimated against the true ones.

ATE is the distance between places after alignment; RPE what is left of the motion between two poses when the true one
is undone, over all pairs --delta apart (metres: along the aligned estimate, within a tenth); KITTI's errors are over
stretches of 100 to 800 m of the true path, or of 5 to 50 m where none of 100 m fits. Frames without an estimated or a
true pose, and lost ones, are left out and counted. A monocular run without scale is aligned by Sim(3).

TUM files (NAME.est.tum, NAME.true.tum) hold the frames that are judged, each as `timestamp x y z qx qy qz qw`; KITTI
files (NAME.est.kitti, NAME.true.kitti) the same frames, against the first. Both hold the ego frame (x forward, y left,
z up, on the road), where KITTI's own files hold the left camera's: hold them against each other, not against KITTI's.
Without truth there is only NAME.est.
"""
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/sample.mcap
  roadperc-trajectory runs/sample.mcap                          from the table beside the log
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
    add("runs", metavar="RUN", nargs="+", help="OUT.metrics.parquet, the OUT.mcap beside it, a folder, or a glob")
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
    judged: list[Judgement] = []
    refused: list[TableError] = []
    exported = 0
    for item in runs:
        try:
            poses = read_poses(item)
            exported += _export(poses, options)
            judged.append(judge(poses, options.alignment, options.delta))
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


def _export(poses: RunPoses, options: _Options) -> bool:
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
