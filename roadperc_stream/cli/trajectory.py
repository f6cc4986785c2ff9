"""``roadperc-trajectory``: measure the errors of a run's path, and export estimated and true poses."""

import argparse
from pathlib import Path
from typing import get_args

from roadperc_stream.cli.arguments import result_files_of
from roadperc_stream.cli.completers import RUNS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_result_files, command_parser, parse
from roadperc_stream.cli.values import ABOVE_0, number

_DESCRIPTION = """\
Compare the estimated poses of a run with the true poses.

errors:
  ATE    distance between estimated and true positions after alignment
  RPE    difference between estimated and true motion, over all pairs of poses --delta apart (in metres: along the
         aligned estimate, within a tenth)
  KITTI  drift over sections of 100 to 800 m of the true path; of 5 to 50 m on shorter paths
  Frames without an estimated or a true pose, and lost frames, are counted and left out. Runs of one camera without
  scale are aligned by Sim(3). Segments of a log (a second recording, a bag played in a loop) are aligned and measured
  separately. Results of --continue are one run.

exported files:
  NAME.est.tum, NAME.true.tum       one line per evaluated frame: timestamp x y z qx qy qz qw
  NAME.est.kitti, NAME.true.kitti   the same frames, relative to the first
  Poses are those of the ego frame (x forward, y left, z up, on the road). KITTI's own files have poses of the left
  camera, so do not compare them with these. Without truth only NAME.est is written. Segments have their own files:
  NAME.segment-0.est.tum.
"""
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/sample.mcap
  roadperc-trajectory runs/sample.mcap                          from the table of the log
  roadperc-trajectory runs/ --align sim3                        one row per run, only the shape of the paths
  roadperc-trajectory runs/sample.mcap --delta 5 --delta-unit metres --export-tum paths/
  evo_ape tum paths/sample.true.tum paths/sample.est.tum -a     prints the same ATE
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-trajectory``: print the errors of paths, and export poses."""
    parser = _parser()
    arguments = parse(parser, argv)
    if arguments.delta_unit == "frames" and arguments.delta != int(arguments.delta):
        parser.error(f"argument --delta: {arguments.delta:g}: expected whole frames, or --delta-unit metres")
    from roadperc_stream.eval.trajectory.errors import Delta
    from roadperc_stream.eval.trajectory.poses import PoseFormat
    from roadperc_stream.eval.trajectory.trajectory import trajectories

    delta = Delta(arguments.delta, arguments.delta_unit)
    folders: dict[PoseFormat, Path | None] = {"tum": arguments.export_tum, "kitti": arguments.export_kitti}
    exports = {kind: folder for kind, folder in folders.items() if folder}
    how = arguments.align, delta, exports, result_files_of(arguments)
    return run(lambda: trajectories(arguments.runs, *how))


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.eval.options import Alignment, DeltaUnit

    parser = command_parser("trajectory", _DESCRIPTION, _EXAMPLE)
    runs = "OUT.metrics.parquet, an OUT.mcap with its table, a folder, or a glob"
    add(parser, "runs", metavar="RUN", nargs="+", help=runs, completer=files(*RUNS))
    add(
        parser,
        "--align",
        choices=get_args(Alignment),
        help="align the estimate to the truth by rotation and translation (se3), also scale (sim3), the first pose "
        "(origin), or not (none); default se3, or sim3 for a run without scale",
    )
    positive = number(ABOVE_0, 1e9, "more than 0")
    delta = "distance of the poses of a pair (default 1)"
    add(parser, "--delta", metavar="N", type=positive, default=1.0, help=delta)
    unit = "unit of --delta (default frames)"
    add(parser, "--delta-unit", choices=get_args(DeltaUnit), default="frames", help=unit)
    for option, kind in (("--export-tum", "TUM"), ("--export-kitti", "KITTI")):
        text = f"write {kind} files of the ego frame to this folder; existing files are replaced"
        add(parser, option, metavar="DIR", type=Path, help=text, completer=files())
    add_result_files(parser)
    return parser
