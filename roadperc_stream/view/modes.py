"""Runs the modes of roadperc-view: Rerun, Foxglove, layout and video."""

import argparse
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from shlex import quote
from typing import Any

from roadperc_stream import log
from roadperc_stream.input.source import warnings_of
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.schemas.topics import TIMES_TOPIC
from roadperc_stream.system.files import require_free
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.time import ns_to_seconds
from roadperc_stream.view.differences import find_differences
from roadperc_stream.view.frame_times import Stop, find_stop
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
    stop = None
    if arguments.frame is not None:
        stop = find_stop(arguments.log, arguments.frame, parse_topic_options(arguments.topic))
    _view(arguments, playback, stop)


def view_frame(arguments: argparse.Namespace, playback: PlaybackOptions, lookup: Any) -> None:
    """Show the frame of a run, of a dataset's log or of two runs; what is not kept is replayed.

    Args:
        arguments: of the command line.
        playback: options of the live server.
        lookup: the module ``eval.frames``.

    Raises:
        RoadpercError: the run cannot be found, replayed or shown.
    """
    runs = [arguments.log, *([arguments.new] if arguments.new else [])]
    wanted = lookup.Wanted(
        runs, arguments.frame, arguments.worst, arguments.of_log, arguments.config, tuple(arguments.topic)
    )
    with ExitStack() as files:
        with frame_progress("replaying", not arguments.quiet) as progress:
            found = lookup.find_frames(wanted, files, progress)
        if not arguments.quiet:
            _print_summary((note for item in found for note in item.notes), {})
        overrides = parse_topic_options(arguments.topic)
        stops = [
            None if item.frame is None else replace(find_stop(item.log, item.number, overrides), frame=item.frame)
            for item in found
        ]
        if len(found) > 1:
            _show_pair(arguments, [item.log for item in found], stops[0])
        else:
            arguments.log = found[0].log
            _view(arguments, playback, stops[0])


def _view(arguments: argparse.Namespace, playback: PlaybackOptions, stop: Stop | None) -> None:
    if arguments.foxglove_layout:
        _lay_out(arguments)
    if arguments.foxglove:
        serve_log(arguments.log, _starting_at(arguments.log, playback, stop), quiet=arguments.quiet)
    elif arguments.foxglove_layout:
        return
    elif arguments.video:
        _record_video(arguments)
    else:
        _show_in_rerun(arguments, stop)


def _starting_at(path: Path, playback: PlaybackOptions, stop: Stop | None) -> PlaybackOptions:
    """The options with the start at a frame."""
    if stop is None:
        return playback
    return replace(playback, start_s=ns_to_seconds(stop.log_time_ns - (log.summarise(path).first_ns or 0)))


def _show_pair(arguments: argparse.Namespace, logs: Sequence[Path], stop: Stop | None) -> None:
    """Save or show two runs in one recording, at a frame or at the worst difference."""
    base, new = logs
    differences = find_differences(base, new)
    if stop is None and differences:
        stop = differences[0].worst
    rerun = import_module("roadperc_stream.view.rerun")
    overrides = parse_topic_options(arguments.topic)
    runs = rerun.ShownLog(base, overrides, stop), rerun.ShownLog(new, overrides)
    name, target = f"{base.stem} and {new.stem}", arguments.save
    if target:
        require_free(target, force=arguments.force, source=base, suffix=".rrd")
    with frame_progress("writing" if target else "sending", not arguments.quiet) as progress:
        export = rerun.export_of_pair(*runs, differences, progress)
        exported = rerun.save(name, target, export, force=arguments.force) if target else rerun.send(name, export)
    _report(arguments, exported, stop)


def _readable(arguments: argparse.Namespace) -> Path:
    """A file that can be read repeatedly: store a pipe; with ``--recover`` repair a damaged log."""
    (path,) = log.received([Path(arguments.log)])
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


def _show_in_rerun(arguments: argparse.Namespace, stop: Stop | None) -> None:
    """Save a recording, or send the log to a viewer."""
    target = arguments.save
    rerun = import_module("roadperc_stream.view.rerun")  # on use only, because the import takes half a second
    overrides = parse_topic_options(arguments.topic)
    with frame_progress("writing" if target else "sending", not arguments.quiet) as progress:
        if target:
            options = {"force": arguments.force, "progress": progress, "stop": stop}
            exported = rerun.save_recording(arguments.log, target, overrides, **options)
        else:
            exported = rerun.open_viewer(arguments.log, overrides, progress, stop)
    _report(arguments, exported, stop)


def _report(arguments: argparse.Namespace, exported: Any, stop: Stop | None) -> None:
    """Print what was exported, and the frame that the viewer shows."""
    target = arguments.save
    if arguments.quiet:
        return
    _print_summary(exported.notes, exported.problems)
    if stop is not None:
        print_line(f"opens at frame {stop.frame}; for later frames choose the timeline message_log_time")
    if target:
        frames = f" ({exported.frames} frames)" if exported.frames else ""
        print_line(f"wrote {target}{frames}; open it with: rerun {quote(str(target))}")


def _print_summary(notes: Iterable[str], problems: Mapping[str, int]) -> None:
    for note in notes:
        print_line(f"note: {note}")
    for topic, count in problems.items():
        print_line(f"warning: {number(count, 'message')} on {topic} could not be read, not shown")
