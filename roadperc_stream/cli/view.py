"""``roadperc-view``: a log in Rerun, in Foxglove, or as a video."""

import argparse
from dataclasses import replace
from pathlib import Path

from roadperc_stream.cli.arguments import add_serving_arguments, add_topic_argument, given_options, serving_options
from roadperc_stream.cli.completers import LOGS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, parse, run, seconds

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap out.mcap
  roadperc-view out.mcap                    the Rerun viewer, arranged for this log
  roadperc-view out.mcap --save out.rrd     save it as a file: rerun out.rrd
  roadperc-view out.mcap --foxglove         for Foxglove: Open connection, ws://localhost:8765
  roadperc-view out.mcap --foxglove-layout road.json
                                            the same arrangement for Foxglove, of this log's topics: Import from file
  roadperc-view out.mcap --foxglove --foxglove-layout live.json
                                            serve the log, with a layout that has the times of the stages
  roadperc-view out.mcap --video out.mp4    a video, without a viewer

An input log opens too. rerun LOG.mcap shows channels that this project does not know.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-view``."""
    parser = _parser()
    arguments = parse(parser, argv)
    _require_sense(parser, arguments)
    from roadperc_stream.view.modes import view_log

    options = replace(serving_options(arguments), start_s=arguments.start or 0.0)
    return run(lambda: view_log(arguments, options))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("view", "Show a log in the Rerun viewer, or where an option says.", _EXAMPLE)
    log = parser.add_argument("log", metavar="OUT.mcap", type=Path, nargs="?", help="a log; - for standard input")
    add = parser.add_mutually_exclusive_group().add_argument
    save = add("--save", metavar="FILE.rrd", type=Path, help="write a Rerun recording and open nothing")
    add("--foxglove", action="store_true", help="serve the log live to Foxglove")
    video = add("--video", metavar="FILE.mp4", type=Path, help="write a video of the log")
    layout = parser.add_argument(
        "--foxglove-layout",
        metavar="FILE.json",
        type=Path,
        help="write a Foxglove layout for the log; with --foxglove it includes the times of the stages",
    )
    add_topic_argument(parser)
    parser.add_argument("--recover", action="store_true", help="show the readable part of a damaged log")
    parser.add_argument("--force", action="store_true", help="replace an existing file")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    serving = add_serving_arguments(parser)
    serving.add_argument("--start", metavar="SECONDS", type=seconds, help="start this long after the first message")
    for action, suffixes in ((log, LOGS), (save, (".rrd",)), (layout, (".json",)), (video, (".mp4",))):
        completed_by(action, files(*suffixes))
    return parser


def _require_sense(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Wrong usage: no log, or an option that the chosen way to look does not know."""
    if arguments.log is None and (arguments.foxglove_layout is None or arguments.topic or arguments.foxglove):
        parser.error("expected a log: OUT.mcap")
    if arguments.foxglove_layout and (arguments.save or arguments.video):
        parser.error("--foxglove-layout: not allowed with --save and --video")
    served = [*given_options(arguments), *(["start"] if arguments.start is not None else [])]
    if served and not arguments.foxglove:
        parser.error(f"--{served[0]}: only with --foxglove")
    if arguments.topic and (arguments.video or (arguments.foxglove and not arguments.foxglove_layout)):
        parser.error("--topic: only with the Rerun viewer, --save and --foxglove-layout")
    if arguments.force and not (arguments.save or arguments.foxglove_layout or arguments.video):
        parser.error("--force: only with --save, --foxglove-layout and --video")
