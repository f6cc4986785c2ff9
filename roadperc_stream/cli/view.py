"""``roadperc-view``: show a log in Rerun or Foxglove, or write a video."""

import argparse
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from roadperc_stream.cli.arguments import given_options, serving_options
from roadperc_stream.cli.completers import RUNS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_serving, add_shared, command_parser, parse
from roadperc_stream.cli.values import number
from roadperc_stream.errors import TableError
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import is_bag_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roadperc_stream.log import AnyLog
    from roadperc_stream.view.frame_times import Stop

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap out.mcap
  roadperc-view out.mcap                                open the Rerun viewer with a layout for this log
  roadperc-view out.mcap --frame 34                     open the viewer at a frame
  roadperc-view out.mcap --worst lane_right_error_m     open it at the worst frame of a metric
  roadperc-view base.mcap new.mcap                      compare two runs of a log in one view
  roadperc-view dataset --log drive_2 --frame 34        replay a log of a batch up to the frame, and show it
  roadperc-view out.mcap --save out.rrd                 save a recording; open it with: rerun out.rrd
  roadperc-view out.mcap --foxglove                     in Foxglove: Open connection, ws://localhost:8765
  roadperc-view out.mcap --foxglove-layout road.json    in Foxglove: Import layout from file
  roadperc-view out.mcap --foxglove --foxglove-layout live.json    a layout with the times of the stages
  roadperc-view out.mcap --video out.mp4                write a video

Input logs work too. For channels that this project does not know, use: rerun LOG.mcap
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-view``: show a log."""
    parser = _parser()
    arguments = parse(parser, argv)
    _require_sense(parser, arguments)
    return run(lambda: _view_runs(arguments) if _needs_lookup(arguments) else _view_log(arguments))


def _view_log(arguments: argparse.Namespace) -> None:
    """Show a log, or write a layout without one."""
    from roadperc_stream.view.frame_times import find_stop
    from roadperc_stream.view.modes import readable

    path, frame = arguments.log, arguments.frame
    logs = [readable(Path(path), recover=arguments.recover, quiet=arguments.quiet)] if path else []
    _show(logs, find_stop(logs[0], frame) if logs and frame is not None else None, arguments)


def _show(logs: "Sequence[AnyLog]", stop: "Stop | None", arguments: argparse.Namespace) -> None:
    """Show one or two runs from a frame on in Rerun or Foxglove, or write a layout, a recording or a video."""
    from roadperc_stream.view import modes

    topics = parse_topic_options(arguments.topic)
    layout, live, force, quiet = arguments.foxglove_layout, arguments.foxglove, arguments.force, arguments.quiet
    if layout:
        modes.lay_out(logs[0] if logs else None, layout, topics, live=live, force=force, quiet=quiet)
    if live:
        playback = replace(serving_options(arguments), start_s=arguments.start or 0.0)
        modes.serve(logs[0], stop, playback, quiet=quiet)
    elif arguments.video:
        modes.record_video(logs[0], arguments.video, force=force, quiet=quiet)
    elif not layout:
        modes.show_in_rerun(logs, stop, arguments.save, topics, force=force, quiet=quiet)


def _view_runs(arguments: argparse.Namespace) -> None:
    """Show a frame of a run, of a dataset's log or of two runs; a log that was not kept is replayed."""
    from roadperc_stream.eval.frames import runs_to_show, worst_frame
    from roadperc_stream.eval.replaying import shown
    from roadperc_stream.output.terminal import frame_progress
    from roadperc_stream.view.frame_times import find_stop
    from roadperc_stream.view.modes import print_remarks

    names, configs = [arguments.log, *([arguments.new] if arguments.new else [])], arguments.config
    of_each = [[config] for config in configs] if len(names) == len(configs) == 2 else [configs] * len(names)
    with ExitStack() as files:
        pairs = zip(names, of_each, strict=True)
        runs = [found for name, of_one in pairs for found in runs_to_show(name, arguments.of_log, of_one, files)]
        if len(runs) > 2:
            raise TableError(f"{' '.join(names)}: expected at most two runs, found {len(runs)}")
        frame = worst_frame(runs[-1], arguments.worst) if arguments.worst else arguments.frame
        with frame_progress("replaying", not arguments.quiet) as progress:
            found = [shown(one, frame, arguments.topic, arguments.set, files, progress) for one in runs]
        if not arguments.quiet:
            print_remarks((note for item in found for note in item.notes), {})
        logs, number_in_log = [item.log for item in found], found[0].number
        stop = None if number_in_log is None else replace(find_stop(logs[0], number_in_log), frame=frame)
        _show(logs, stop, arguments)


def _needs_lookup(arguments: argparse.Namespace) -> bool:
    """Whether the arguments name more than a log and a frame in it; the lookup imports polars, which takes 0.2 s."""
    path = Path(arguments.log or "-")
    is_file = path.exists() and not path.is_dir() and path.suffix != ".parquet"
    is_log = str(path) == "-" or is_file or is_bag_folder(path)
    return not is_log or any((arguments.new, arguments.worst, arguments.of_log, arguments.config))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "view", "Show a log in the Rerun viewer or in Foxglove, or write a recording, a layout or a video.", _EXAMPLE
    )
    run_help = "OUT.mcap, OUT.metrics.parquet, an input log, a dataset; - for a pipe"
    add(parser, "log", metavar="RUN", nargs="?", help=run_help, completer=files(*RUNS))
    new = "a second run of the same log, to compare with RUN"
    add(parser, "new", metavar="NEW", nargs="?", help=new, completer=files(*RUNS))
    place = parser.add_mutually_exclusive_group()
    add(place, "--frame", metavar="N", type=number(0, 1e15, "a frame number", int), help="open at this frame")
    add(place, "--worst", metavar="COLUMN", help="open at the worst frame of this column of the metrics table")
    add(parser, "--log", dest="of_log", metavar="NAME", help="the log of a dataset")
    add(
        parser,
        "--config",
        metavar="NAME",
        action="append",
        default=[],
        help="the configuration of a dataset: its name, its first digits or a setting; pass it twice to compare two",
    )
    output = parser.add_mutually_exclusive_group()
    save = "write a Rerun recording, and open no viewer"
    add(output, "--save", metavar="FILE.rrd", type=Path, help=save, completer=files(".rrd"))
    add(output, "--foxglove", action="store_true", help="play the log to Foxglove")
    video = "write a video of the log"
    add(output, "--video", metavar="FILE.mp4", type=Path, help=video, completer=files(".mp4"))
    layout = "write a Foxglove layout for the log; with --foxglove it shows the times of the stages"
    add(parser, "--foxglove-layout", metavar="FILE.json", type=Path, help=layout, completer=files(".json"))
    add_shared(
        parser,
        "topic",
        "quiet",
        set="if a frame is replayed: change a setting of the run, or repeat STAGE.implementation=MODULE:NAME",
        recover="show the readable part of a damaged log",
        force="replace an existing file",
    )
    add_shared(add_serving(parser), "start")
    return parser


def _require_sense(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Exit with code 2 if the log is missing or an option does not apply to the chosen output."""
    if arguments.log is None and (arguments.foxglove_layout is None or arguments.topic or arguments.foxglove):
        parser.error("expected a log: OUT.mcap")
    pair = arguments.new is not None or len(arguments.config) > 1
    at_frame = arguments.frame is not None or arguments.worst
    if (pair or at_frame) and (arguments.video or arguments.foxglove_layout):
        parser.error("--frame, --worst and NEW apply only to the Rerun viewer, --save and --foxglove")
    if pair and arguments.foxglove:
        parser.error("--foxglove plays one log; remove NEW")
    if at_frame and arguments.start is not None:
        parser.error("--frame and --worst cannot be combined with --start")
    if arguments.foxglove_layout and (arguments.save or arguments.video):
        parser.error("--foxglove-layout cannot be combined with --save or --video")
    served = [*given_options(arguments), *(["start"] if arguments.start is not None else [])]
    if served and not arguments.foxglove:
        parser.error(f"--{served[0]} needs --foxglove")
    if arguments.topic and (arguments.video or (arguments.foxglove and not arguments.foxglove_layout)):
        parser.error("--topic applies only to the Rerun viewer, --save and --foxglove-layout")
    if arguments.force and not (arguments.save or arguments.foxglove_layout or arguments.video):
        parser.error("--force needs --save, --foxglove-layout or --video")
