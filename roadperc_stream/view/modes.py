"""Runs the modes of roadperc-view: Rerun, Foxglove, layout and video."""

import argparse
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from shlex import quote

from roadperc_stream import log
from roadperc_stream.input.source import warnings_of
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.schemas.topics import TIMES_TOPIC
from roadperc_stream.system.text import number, print_line
from roadperc_stream.view.layout.arrangement import write_layout
from roadperc_stream.view.live import PlaybackOptions
from roadperc_stream.view.live.serving import log_with_times, serve_log
from roadperc_stream.view.video import write_video


def view_log(arguments: argparse.Namespace, playback: PlaybackOptions) -> None:
    """Show a log, or write it as a layout, recording or video.

    Raises:
        RoadpercError: the log cannot be shown.
    """
    arguments.log = arguments.log and _readable(arguments)
    if arguments.foxglove_layout:
        _lay_out(arguments)
    if arguments.foxglove:
        serve_log(arguments.log, playback, quiet=arguments.quiet)
    elif arguments.foxglove_layout:
        return
    elif arguments.video:
        _record_video(arguments)
    else:
        _show_in_rerun(arguments)


def _readable(arguments: argparse.Namespace) -> Path:
    """A file that can be read repeatedly: store a pipe; with ``--recover`` repair a damaged log."""
    (path,) = log.received([arguments.log])
    if not arguments.recover or log.audited(path, check_chunks=True).whole:
        return path
    copy = log.repaired_copy(path)
    if not arguments.quiet:
        for warning in warnings_of(path, copy.salvage.damages, copy.recovery, copy.salvage.first_ns):
            print_line(f"warning: {warning}")
    return copy.path


def _lay_out(arguments: argparse.Namespace) -> None:
    overrides = parse_topic_options(arguments.topic)
    channels = log_with_times(arguments.log).channels if arguments.foxglove else ()
    timed = any(channel.topic == TIMES_TOPIC for channel in channels)
    write_layout(arguments.foxglove_layout, arguments.log, overrides, timed=timed, force=arguments.force)
    if not arguments.quiet:
        print_line(f"wrote {arguments.foxglove_layout}")


def _record_video(arguments: argparse.Namespace) -> None:
    with frame_progress("writing", not arguments.quiet) as progress:
        video = write_video(arguments.log, arguments.video, force=arguments.force, progress=progress)
    if not arguments.quiet:
        _print_summary(video.problems.first.values(), video.problems.counts)
        print_line(
            f"wrote {arguments.video} ({video.pictures} pictures at {video.rate_hz:.3g} Hz, of {video.frames} frames)"
        )


def _show_in_rerun(arguments: argparse.Namespace) -> None:
    """Save a recording, or send the log to a viewer."""
    target = arguments.save
    rerun = import_module("roadperc_stream.view.rerun")  # on use only, because the import takes half a second
    overrides = parse_topic_options(arguments.topic)
    with frame_progress("writing" if target else "sending", not arguments.quiet) as progress:
        if target:
            exported = rerun.save_recording(arguments.log, target, overrides, force=arguments.force, progress=progress)
        else:
            exported = rerun.open_viewer(arguments.log, overrides, progress)
    if arguments.quiet:
        return
    _print_summary(exported.notes, exported.problems)
    if target:
        frames = f" ({exported.frames} frames)" if exported.frames else ""
        print_line(f"wrote {target}{frames}; open it with: rerun {quote(str(target))}")


def _print_summary(notes: Iterable[str], problems: Mapping[str, int]) -> None:
    for note in notes:
        print_line(f"note: {note}")
    for topic, count in problems.items():
        print_line(f"warning: {number(count, 'message')} on {topic} could not be read, not shown")
