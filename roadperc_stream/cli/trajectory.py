"""``roadperc-trajectory``: how far a run's path is from the true one, and both as files for other tools."""

import argparse
from pathlib import Path
from typing import get_args

from roadperc_stream.cli.completers import RUNS, completed_by, files
from roadperc_stream.cli.plumbing import ABOVE_0, command_parser, number, parse, part, run

_DESCRIPTION = """\
Compare the poses a run estimated with the true ones.

ATE is the distance between places after alignment; RPE what is left of the motion between two poses when the true one
is undone, over all pairs --delta apart (metres: along the aligned estimate, within a tenth); KITTI's errors are over
stretches of 100 to 800 m of the true path, or of 5 to 50 m where none of 100 m fits. Frames without an estimated or a
true pose, and lost ones, are left out and counted. A monocular run without scale is aligned by Sim(3).

TUM files (NAME.est.tum, NAME.true.tum) hold the frames that are evaluated, each as `timestamp x y z qx qy qz qw`; KITTI
files (NAME.est.kitti, NAME.true.kitti) the same frames, against the first. Both hold the ego frame (x forward, y left,
z up, on the road), where KITTI's own files hold the left camera's: compare them with each other, not with KITTI's.
Without truth there is only NAME.est. Each segment of a log (another recording, a bag played in a loop) is aligned and
measured by itself, and has files of its own: NAME.segment-0.est.tum. The parts of a drive (--continue) are one run.
"""
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/sample.mcap
  roadperc-trajectory runs/sample.mcap                          from the table next to the log
  roadperc-trajectory runs/ --align sim3                        a row a run, path shapes only
  roadperc-trajectory runs/sample.mcap --delta 5 --delta-unit metres --export-tum paths/
  evo_ape tum paths/sample.true.tum paths/sample.est.tum -a     says the same ATE
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-trajectory``: print the errors of runs' paths, and export them."""
    parser = _parser()
    arguments = parse(parser, argv)
    if arguments.delta_unit == "frames" and arguments.delta != int(arguments.delta):
        parser.error(f"argument --delta: {arguments.delta:g}: expected whole frames, or --delta-unit metres")
    judging = part("eval.trajectory")
    delta = judging.Delta(arguments.delta, arguments.delta_unit)
    folders = arguments.export_tum, arguments.export_kitti
    return run(lambda: judging.print_trajectories(arguments.runs, arguments.align, delta, *folders))


def _parser() -> argparse.ArgumentParser:
    options = part("eval.options")
    parser = command_parser("trajectory", _DESCRIPTION, _EXAMPLE)
    add, positive = parser.add_argument, number(ABOVE_0, 1e9, "more than 0")
    runs = add(
        "runs", metavar="RUN", nargs="+", help="OUT.metrics.parquet, the OUT.mcap next to it, a folder, or a glob"
    )
    add(
        "--align",
        choices=get_args(options.Alignment),
        help="how the estimate is aligned to the truth: turned and shifted, scaled too, first pose on first pose, or "
        "not at all (default se3; sim3 where the run has no scale)",
    )
    add("--delta", metavar="N", type=positive, default=1.0, help="how far apart the poses of a pair are (default 1)")
    add("--delta-unit", choices=get_args(options.DeltaUnit), default="frames", help="unit of N (default frames)")
    tum = add("--export-tum", metavar="DIR", type=Path, help="write TUM files into this folder; replaces earlier ones")
    kitti = add(
        "--export-kitti", metavar="DIR", type=Path, help="write KITTI files into this folder; replaces earlier ones"
    )
    for action, completer in ((runs, files(*RUNS)), (tum, files()), (kitti, files())):
        completed_by(action, completer)
    return parser
