"""``roadperc-lanes``: write the lanes of a run as TuSimple's JSON lines, and score them against truth."""

import argparse
from pathlib import Path
from typing import get_args

from roadperc_stream.cli.completers import LOGS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, command_parser, parse
from roadperc_stream.cli.values import image_size

_DESCRIPTION = """\
Write the lanes of a run as TuSimple's JSON lines, and score them against true lanes in the same format.

lines:
  A boundary is the smoothed line in the image (line_px), at every tenth row from 160 to 710 of 720 rows, scaled to
  the height of the image. raw_file is LOG/STAMP_NS. run_time is total_ms from the table of the log, 0 without a table.
  With --truth, rows (h_samples) and raw_file are those of the true frame. Frames without truth are left out.

pairs:
  By default the stamp at the end of raw_file pairs a true frame with a frame. --pair order pairs them in order.
  In a log that roadperc-convert made of TuSimple or CULane, the names of the images pair them. So the official files
  score its run: label_data_*.json of TuSimple, list/*.txt of CULane. Lines of images outside the log are left out.

scores:
  TuSimple: a point is correct within 20 px over the cosine of the lane's angle. A lane is found if 85 % of its points
  are correct. CULane: F1 of lines 30 px wide. Pixels refer to 1280 and 1640 image columns and scale with the image.
  A true frame without a frame of the run counts as a frame without lanes.
  For the log's own truth (/truth/lanes) see roadperc-report.
"""
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/sample.mcap
  roadperc-lanes runs/sample.mcap --tusimple sample.json                write the lanes of the run
  roadperc-replay logs/sample.mcap runs/other.mcap --set lanes.model=line
  roadperc-lanes runs/other.mcap --truth sample.json                    score another run against them
  roadperc-lanes runs/clips.mcap --truth tusimple/label_data_0313.json
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-lanes``: export and score the lanes of a run."""
    parser = _parser()
    arguments = parse(parser, argv)
    if not (arguments.tusimple or arguments.truth):
        parser.error("expected --tusimple FILE, --truth FILE, or both")
    from roadperc_stream.eval.lanes.lanes import print_lanes

    options = arguments.tusimple, arguments.truth, arguments.pair, arguments.size
    return run(lambda: print_lanes(arguments.log, *options))


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.eval.options import LanePairing

    parser = command_parser("lanes", _DESCRIPTION, _EXAMPLE)
    log = "a log with results of roadperc-replay"
    add(parser, "log", metavar="OUT.mcap", type=Path, help=log, completer=files(*LOGS))
    tusimple = "write the lanes to this file; an existing file is replaced"
    add(parser, "--tusimple", metavar="FILE.json", type=Path, help=tusimple, completer=files(".json"))
    truth = "score against the true lanes in this .json file of TuSimple's format, or of this .txt list of CULane"
    add(parser, "--truth", metavar="FILE", type=Path, help=truth, completer=files(".json", ".txt"))
    pair = "pair true frames by the stamp in raw_file, or in order (default stamp)"
    add(parser, "--pair", choices=get_args(LanePairing), default="stamp", help=pair)
    size = "image size that the pixels in FILE.json refer to (default: the camera's)"
    add(parser, "--size", metavar="WxH", type=image_size, help=size)
    return parser
