"""``roadperc-lanes``: a run's lanes as TuSimple's JSON lines, and their score against true ones."""

import argparse
from pathlib import Path
from typing import get_args

from roadperc_stream.cli.completers import LOGS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, image_size, parse, part, run

_DESCRIPTION = """\
Write the lanes a run saw as TuSimple's JSON lines, and score them against true ones in the same format.

Each boundary is the smoothed line in the image (line_px), at every tenth row from 160 to 710 of 720 or the same part
of another height; with --truth it is at the true frame's own h_samples and under its raw_file, and only frames that
have a truth are written. raw_file is LOG/STAMP_NS, and run_time the frame's total_ms from the table next to the log,
0 without one. A true frame belongs to the frame whose stamp ends its raw_file; --pair order takes them as they come.

Scores are TuSimple's (20 px over the cosine of the lane's angle, lanes found at 85 % of their points) and CULane's F1
(lines 30 px wide), with pixels scaled from the benchmarks' 1280 and 1640 columns to the image's. A true frame that the
run lacks scores as one in which it saw nothing. What the log itself carries as /truth/lanes the replay has scored
already: roadperc-report shows it.
"""
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/sample.mcap
  roadperc-lanes runs/sample.mcap --tusimple sample.json                write what the run saw
  roadperc-replay logs/sample.mcap runs/other.mcap --set lanes.model=line
  roadperc-lanes runs/other.mcap --truth sample.json                    hold another run against it
  roadperc-lanes runs/clips.mcap --truth test_label.json --pair order --size 1280x720
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-lanes``: export a run's lanes, and score them."""
    parser = _parser()
    arguments = parse(parser, argv)
    if not (arguments.tusimple or arguments.truth):
        parser.error("expected --tusimple FILE, --truth FILE, or both")
    lanes, options = part("eval.lanes"), (arguments.tusimple, arguments.truth, arguments.pair, arguments.size)
    return run(lambda: lanes.print_lanes(arguments.log, *options))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("lanes", _DESCRIPTION, _EXAMPLE)
    add = parser.add_argument
    log = add("log", metavar="OUT.mcap", type=Path, help="a log with results, as roadperc-replay writes it")
    tusimple = add(
        "--tusimple", metavar="FILE.json", type=Path, help="write the lanes into this file; replaces an earlier one"
    )
    truth = add("--truth", metavar="FILE.json", type=Path, help="true lanes in TuSimple's format")
    add(
        "--pair",
        choices=get_args(part("eval.options").LanePairing),
        default="stamp",
        help="how true frames find theirs: by the stamp in raw_file, or in order, a line a frame (default stamp)",
    )
    add("--size", metavar="WxH", type=image_size, help="image in whose pixels FILE.json is (default the camera's)")
    for action, suffixes in ((log, LOGS), (tusimple, (".json",)), (truth, (".json",))):
        completed_by(action, files(*suffixes))
    return parser
