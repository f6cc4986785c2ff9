"""``roadperc-view``: a log in Rerun, in Foxglove, or as a film."""

import argparse
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from shlex import quote

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import frame_progress, run
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.view.layout import write_layout
from roadperc_stream.view.live.options import add_playback_arguments, given_options, playback_options
from roadperc_stream.view.live.serving import serve_log
from roadperc_stream.view.video import write_video

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap out.mcap
  roadperc-view out.mcap                    the Rerun viewer, arranged for this log
  roadperc-view out.mcap --save out.rrd     the same as a file: rerun out.rrd
  roadperc-view out.mcap --foxglove         for Foxglove: Open connection, ws://localhost:8765
  roadperc-view out.mcap --foxglove-layout road.json
                                            the same arrangement for Foxglove, of this log's topics: Import from file
  roadperc-view out.mcap --video out.mp4    a film, for those who have no viewer

An input log opens as well, with what it has. rerun LOG.mcap shows the channels that this project does not know.
"""
_RERUN = "roadperc_stream.view.rerun"
"""Imported where it is used: it takes half a second, which no other way to look at a log should pay."""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-view``."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    _require_sense(parser, arguments)
    return run(lambda: _view(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-view",
        description="Look at a log: in the Rerun viewer unless an option says where else.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("log", metavar="OUT.mcap", type=Path, nargs="?")
    modes = parser.add_mutually_exclusive_group()
    modes.add_argument("--save", metavar="FILE.rrd", type=Path, help="write a Rerun recording and open nothing")
    modes.add_argument("--foxglove", action="store_true", help="serve the log live to Foxglove")
    modes.add_argument("--foxglove-layout", metavar="FILE.json", type=Path, help="write Foxglove's layout for the log")
    modes.add_argument("--video", metavar="FILE.mp4", type=Path, help="write a film of the log")
    parser.add_argument("--topic", metavar="ROLE=/NAME", action="append", default=[], help="the topic of a role")
    parser.add_argument("--force", action="store_true", help="replace an existing file")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    add_playback_arguments(parser)
    return parser


def _require_sense(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Wrong usage: no log, or an option that the chosen way to look does not know."""
    if arguments.log is None and (arguments.foxglove_layout is None or arguments.topic):
        parser.error("expected a log: OUT.mcap")
    served = [*given_options(arguments), *(["start"] if arguments.start is not None else [])]
    if served and not arguments.foxglove:
        parser.error(f"--{served[0]}: only with --foxglove")
    if arguments.topic and (arguments.foxglove or arguments.video):
        parser.error("--topic: only with the Rerun viewer, --save and --foxglove-layout")
    if arguments.force and not (arguments.save or arguments.foxglove_layout or arguments.video):
        parser.error("--force: only with --save, --foxglove-layout and --video")


def _view(arguments: argparse.Namespace) -> None:
    if arguments.foxglove:
        serve_log(arguments.log, playback_options(arguments), quiet=arguments.quiet)
    elif arguments.foxglove_layout:
        _lay_out(arguments)
    elif arguments.video:
        _film(arguments)
    elif arguments.save:
        _save(arguments)
    else:
        _open(arguments)


def _lay_out(arguments: argparse.Namespace) -> None:
    overrides = parse_topic_options(arguments.topic)
    write_layout(arguments.foxglove_layout, arguments.log, overrides, force=arguments.force)
    if not arguments.quiet:
        print(f"wrote {arguments.foxglove_layout}")


def _film(arguments: argparse.Namespace) -> None:
    with frame_progress("filming", not arguments.quiet) as progress:
        film = write_video(arguments.log, arguments.video, force=arguments.force, progress=progress)
    if not arguments.quiet:
        _print_summary(film.problems.first.values(), film.problems.counts)
        print(f"wrote {arguments.video} ({film.pictures} pictures at {film.rate_hz:.3g} Hz, of {film.frames} frames)")


def _save(arguments: argparse.Namespace) -> None:
    with frame_progress("writing", not arguments.quiet) as progress:
        exported = import_module(_RERUN).save_recording(
            arguments.log,
            arguments.save,
            parse_topic_options(arguments.topic),
            force=arguments.force,
            progress=progress,
        )
    if not arguments.quiet:
        _print_summary(exported.notes, exported.problems)
        frames = f" ({exported.frames} frames)" if exported.frames else ""
        print(f"wrote {arguments.save}{frames}; open it with: rerun {quote(str(arguments.save))}")


def _open(arguments: argparse.Namespace) -> None:
    with frame_progress("sending", not arguments.quiet) as progress:
        exported = import_module(_RERUN).open_viewer(arguments.log, parse_topic_options(arguments.topic), progress)
    if not arguments.quiet:
        _print_summary(exported.notes, exported.problems)


def _print_summary(notes: Iterable[str], problems: Mapping[str, int]) -> None:
    for note in notes:
        print(f"note: {note}")
    for topic, number in problems.items():
        print(f"warning: {number} messages on {topic} could not be read; they are not shown")
