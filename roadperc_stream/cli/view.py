"""``roadperc-view``: show a log in Rerun or Foxglove, or write a picture or a video."""

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
from roadperc_stream.schemas.topics import DEBUG_PREFIX, OVERLAY_TOPIC
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
  roadperc-view out.mcap --frame 34 --png frame.png     write one picture: a frame with its results
  roadperc-view out.mcap --frame 34 --png edges.png --topic /perception/debug/lanes
  roadperc-view out.mcap --video out.webm               write a video

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

    topics, picture = _roles(arguments), _picture(arguments)
    layout, live, force, quiet = arguments.foxglove_layout, arguments.foxglove, arguments.force, arguments.quiet
    if layout:
        modes.lay_out(logs[0] if logs else None, layout, topics, live=live, force=force, quiet=quiet)
    if live:
        playback = replace(serving_options(arguments), start_s=arguments.start or 0.0)
        modes.serve(logs[0], stop, playback, quiet=quiet)
    elif arguments.png:
        assert stop is not None  # --png needs a frame
        modes.save_picture(logs[0], stop, picture, arguments.png, force=force, quiet=quiet)
    elif arguments.video:
        modes.record_video(logs[0], arguments.video, picture, force=force, quiet=quiet)
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
            asked = _roles(arguments), _picture(arguments) if arguments.png else ""
            found = [shown(one, frame, *asked, arguments.set, files, progress) for one in runs]
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
    is_debug = bool(arguments.png) and _picture(arguments).startswith(DEBUG_PREFIX)
    return not is_log or is_debug or any((arguments.new, arguments.worst, arguments.of_log, arguments.config))


def _roles(arguments: argparse.Namespace) -> dict[str, str]:
    """The topics by role; a picture's topic has no role."""
    pictures = arguments.png or arguments.video
    return parse_topic_options(name for name in arguments.topic if not (pictures and name.startswith("/")))


def _picture(arguments: argparse.Namespace) -> str:
    """The topic of the picture or the video."""
    return next((name for name in arguments.topic if name.startswith("/")), OVERLAY_TOPIC)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "view",
        "Show a log in Rerun or Foxglove, or write a picture, a video, a recording or a layout.",
        _EXAMPLE,
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
    png = "write the picture of one frame: the overlay, or that of --topic"
    add(output, "--png", metavar="FILE.png", type=Path, help=png, completer=files(".png"))
    video = "write a video of the overlays, or of --topic; .mp4 is smaller, .webm is much faster"
    add(output, "--video", metavar="FILE.webm", type=Path, help=video, completer=files(".webm", ".mp4"))
    layout = "write a Foxglove layout for the log; with --foxglove it shows the times of the stages"
    add(parser, "--foxglove-layout", metavar="FILE.json", type=Path, help=layout, completer=files(".json"))
    add_shared(
        parser,
        "quiet",
        topic="use this topic for a role; with --png and --video /NAME is the topic of the picture",
        set="if a frame is replayed: change a setting of the run, or repeat STAGE.implementation=MODULE:NAME",
        recover="show the readable part of a damaged log",
        force="replace an existing file",
    )
    add_shared(add_serving(parser), "start")
    return parser


def _require_sense(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Exit with code 2 if the log is missing or an option does not apply to the chosen output."""
    layout, live, png, video = arguments.foxglove_layout, arguments.foxglove, arguments.png, arguments.video
    pair = arguments.new is not None or len(arguments.config) > 1
    at_frame = arguments.frame is not None or arguments.worst
    served = [*given_options(arguments), *(["start"] if arguments.start is not None else [])]
    by_role = [name for name in arguments.topic if not name.startswith("/")]
    written = arguments.save or png or video
    from_frame, roles = (pair or at_frame) and (video or layout), by_role and (video or (live and not layout))
    refused = (
        (arguments.log is None and (layout is None or arguments.topic or live), "expected a log: OUT.mcap"),
        (from_frame, "--frame, --worst and NEW apply only to the Rerun viewer, --save, --png and --foxglove"),
        (pair and live, "--foxglove plays one log; remove NEW"),
        (pair and png, "--png shows one log; remove NEW"),
        (png and not at_frame, "--png shows one frame; pass --frame N or --worst COLUMN"),
        (at_frame and arguments.start is not None, "--frame and --worst cannot be combined with --start"),
        (layout and written, "--foxglove-layout cannot be combined with --save, --png or --video"),
        (served and not live, f"--{''.join(served[:1])} needs --foxglove"),
        (roles, "--topic ROLE=/NAME applies only to the Rerun viewer, --save, --png and --foxglove-layout"),
        (len(arguments.topic) - len(by_role) > 1, "--topic /NAME: expected the topic of one picture"),
        (arguments.force and not (written or layout), "--force needs --save, --foxglove-layout, --png or --video"),
    )
    for is_wrong, text in refused:
        if is_wrong:
            parser.error(text)
