"""``roadperc-replay``: replay a log through the chain, or list the settings."""

import argparse
import sys
from pathlib import Path
from typing import Final

from roadperc_stream.cli.arguments import given_options, serving_options
from roadperc_stream.cli.completers import LOGS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import (
    ABOUT_LOG,
    REPLAY,
    add,
    add_about_log,
    add_serving,
    add_shared,
    command_parser,
    parse,
)
from roadperc_stream.cli.values import positive_seconds
from roadperc_stream.system.files import is_bag_folder, not_a_log

_USAGE: Final = """\
%(prog)s [options] IN.mcap [IN.mcap ...] OUT.mcap
       %(prog)s --list-settings [--json]
       %(prog)s --print-config [--config FILE] [--set KEY=VALUE] [--only STAGES]"""
_EXAMPLE: Final = """\
example:
  roadperc-replay logs/sample.mcap out.mcap                            replay a log
  roadperc-report out.metrics.parquet                                  print its metrics
  roadperc-replay logs/sample.mcap out2.mcap --set lanes.hold_s=0.8    change a setting
  roadperc-replay --print-config > mine.toml                           write all settings, for --config mine.toml
  roadperc-replay bag.mcap out.mcap --topic image=/front/rgb           use a topic with another name
  roadperc-replay my_bag/ out.mcap                                     read a ROS 2 bag; also .db3 and ROS 1 .bag
  roadperc-replay part_*.mcap out.mcap                                 read several files of one log
  roadperc-replay part_1.mcap out_1.mcap --continue out_0.mcap         continue the result of part_0.mcap
  roadperc-replay long.mcap out.mcap --checkpoint-every 60 --resume    continue after an interruption
  roadperc-replay logs/sample.mcap out.mcap --verify                   test that own stages are deterministic
  curl https://example.org/in.mcap | roadperc-replay - out.mcap        read a pipe
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-replay``: replay a log, or print the settings."""
    parser = _parser()
    arguments = parse(parser, argv, intermixed=True)
    if arguments.list_settings or arguments.print_config:
        _require_alone(parser, arguments)
        from roadperc_stream.cli.settings import print_settings

        return run(lambda: print_settings(arguments))
    _require_sense(parser, arguments)
    from roadperc_stream.cli.replay_log import Bar, replay_log

    bar: Bar | None = None
    if not arguments.quiet and sys.stderr.isatty():
        from roadperc_stream.output.terminal import frame_progress

        bar = frame_progress
    live = None
    if arguments.live:
        from roadperc_stream.view.live.serving import LiveReplay

        live = LiveReplay(serving_options(arguments), quiet=arguments.quiet)
    return run(lambda: replay_log(arguments, live, bar))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "replay",
        "Replay a log through the perception chain. OUT.mcap contains the input and the results,\n"
        "OUT.metrics.parquet a row per frame, OUT.objects.parquet a row per detection.",
        _EXAMPLE,
        _USAGE,
    )
    add(
        parser,
        "logs",
        metavar="IN.mcap ... OUT.mcap",
        type=Path,
        nargs="*",
        default=[],
        help="the log to read (files, the folder of a ROS 2 bag, or - for standard input), then the log to write",
        completer=files(*LOGS),
    )
    add_shared(parser, *REPLAY, "only")
    add_about_log(parser)
    _add_continuation(parser.add_argument_group("continued and long replays"))
    results_only = "write only results to OUT.mcap, without the input's messages"
    add(parser, "--results-only", action="store_true", help=results_only)
    overlay = "write /perception/overlay: the camera image with all results drawn"
    add(parser, "--overlay", action="store_true", help=overlay)
    debug = "write /perception/debug/...: plane search, lane lines, odometry matches, template match, disparity"
    add(parser, "--debug", action="store_true", help=debug)
    add(
        parser,
        "--template",
        metavar="IMAGE|FRAME:X0,Y0,X1,Y1",
        help="search every frame for the obstacle in an image file, or in a box of a frame of IN.mcap; "
        "adds an object with the label template",
        completer=files(".png", ".jpg"),
    )
    add(parser, "--strict", action="store_true", help="stop with an error at the first unusable message")
    verify = "then replay again with other threads and in two parts, and compare; exit with 1 at a difference"
    add(parser, "--verify", action="store_true", help=verify)
    add(parser, "--live", action="store_true", help="serve the results to Foxglove during the replay")
    add_shared(
        parser,
        "quiet",
        recover="replay the readable part of a damaged log and report the losses",
        threads="number of threads, at most 5 (default: one per core); the results do not depend on it",
        force="replace an existing result; an input log is never replaced",
    )
    add_serving(parser)
    _add_settings(parser.add_argument_group("print the settings (without IN.mcap and OUT.mcap)"))
    return parser


def _add_continuation(group: argparse._ArgumentGroup) -> None:
    add(
        group,
        "--continue",
        dest="continued",
        metavar="EARLIER_OUT.mcap",
        type=Path,
        help="continue from the result of the previous file of the log; the settings must be the same",
        completer=files(".mcap"),
    )
    warm_up = "with --start: also run the chain on this much of the log before, without writing results"
    add(group, "--warm-up", metavar="SECONDS", type=positive_seconds, help=warm_up)
    every = "save a checkpoint for --resume every SECONDS of log time"
    add(group, "--checkpoint-every", metavar="SECONDS", type=positive_seconds, help=every)
    resume = "with --checkpoint-every: continue an interrupted replay of the same command, if any"
    add(group, "--resume", action="store_true", help=resume)


def _add_settings(group: argparse._ArgumentGroup) -> None:
    for option, text in (
        ("--list-settings", "print every setting with default, range, unit and meaning"),
        ("--json", "with --list-settings: print JSON"),
        ("--print-config", "print the whole configuration as TOML, for --config"),
    ):
        add(group, option, action="store_true", help=text)


def _require_sense(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Exit with code 2 if a log is missing or options contradict each other."""
    if len(arguments.logs) == 1 and arguments.logs[0].is_dir() and not is_bag_folder(arguments.logs[0]):
        parser.error(not_a_log(arguments.logs[0]))
    missing = ("IN.mcap", "OUT.mcap")[len(arguments.logs) :]
    if missing:
        parser.error(f"the following arguments are required: {', '.join(missing)}")
    if arguments.json:
        parser.error("--json needs --list-settings")
    if arguments.warm_up and arguments.start is None:
        parser.error("--warm-up needs --start")
    if arguments.warm_up and arguments.continued:
        parser.error("--warm-up cannot be combined with --continue, which starts with a state")
    if arguments.resume and not arguments.checkpoint_every:
        parser.error("--resume needs --checkpoint-every")
    if arguments.verify and arguments.live:
        parser.error("--verify cannot be combined with --live")
    if arguments.verify and any(str(path) == "-" or path.is_fifo() for path in arguments.logs[:-1]):
        parser.error("--verify reads the log several times: expected a file, found a pipe")
    if given_options(arguments) and not arguments.live:
        parser.error(f"--{given_options(arguments)[0]} needs --live")


def _require_alone(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Exit with code 2 if an argument contradicts ``--list-settings`` or ``--print-config``."""
    asked, known = "--list-settings", {"list_settings", "json"}
    if not arguments.list_settings:
        asked, known = "--print-config", {"print_config", "config", "set", "only", *ABOUT_LOG}
    given = [name for name, value in vars(arguments).items() if name not in known and value != parser.get_default(name)]
    if given:
        option = {"logs": "IN.mcap", "continued": "--continue"}.get(given[0], f"--{given[0].replace('_', '-')}")
        parser.error(f"{option} cannot be combined with {asked}")
