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
from roadperc_stream.errors import TableError
from roadperc_stream.input.source import warnings_of
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.schemas.topics import TIMES_TOPIC
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
    logs = [_readable(arguments)] if arguments.log else []
    stop = find_stop(logs[0], arguments.frame) if logs and arguments.frame is not None else None
    _view(arguments, playback, logs, stop)


def view_runs(arguments: argparse.Namespace, playback: PlaybackOptions, finding: Any, replaying: Any) -> None:
    """Show a frame of a run, of a dataset's log or of two runs; a log that was not kept is replayed.

    ``finding`` is the module ``eval.frames``, ``replaying`` the module ``eval.frame_replay``.

    Raises:
        RoadpercError: the run cannot be found, replayed or shown.
    """
    names, configs = [arguments.log, *([arguments.new] if arguments.new else [])], arguments.config
    of_each = [[config] for config in configs] if len(names) == len(configs) == 2 else [configs] * len(names)
    with ExitStack() as files:
        pairs = zip(names, of_each, strict=True)
        runs = [run for name, of_one in pairs for run in finding.runs_to_show(name, arguments.of_log, of_one, files)]
        if len(runs) > 2:
            raise TableError(f"{' '.join(names)}: expected at most two runs, found {len(runs)}")
        frame = finding.worst_frame(runs[-1], arguments.worst) if arguments.worst else arguments.frame
        with frame_progress("replaying", not arguments.quiet) as progress:
            found = [replaying.shown(run, frame, arguments.topic, arguments.set, files, progress) for run in runs]
        if not arguments.quiet:
            _print_summary((note for item in found for note in item.notes), {})
        logs, number_in_log = [item.log for item in found], found[0].number
        stop = None if number_in_log is None else replace(find_stop(logs[0], number_in_log), frame=frame)
        _view(arguments, playback, logs, stop)


def _view(
    arguments: argparse.Namespace, playback: PlaybackOptions, logs: Sequence[log.AnyLog], stop: Stop | None
) -> None:
    """Show one or two logs, or none for a layout of all topics."""
    arguments.log = logs[0] if logs else None
    if arguments.foxglove_layout:
        _lay_out(arguments)
    if arguments.foxglove:
        if stop is not None:
            first_ns = log.summarise(logs[0]).first_ns or 0
            playback = replace(playback, start_s=ns_to_seconds(stop.log_time_ns - first_ns))
        serve_log(logs[0], playback, quiet=arguments.quiet)
    elif arguments.foxglove_layout:
        return
    elif arguments.video:
        _record_video(arguments)
    else:
        _show_in_rerun(arguments, logs, stop)


def _readable(arguments: argparse.Namespace) -> log.LogFile:
    """A file that can be read repeatedly: store a pipe; with ``--recover`` repair a damaged log."""
    file = log.received_file(Path(arguments.log))
    if not arguments.recover or log.audited(file).whole:
        return file
    copy = log.repaired_copy(file)
    if not arguments.quiet:
        for warning in warnings_of(file.name, copy.salvage.damages, copy.recovery, copy.salvage.first_ns):
            print_line(f"warning: {warning}")
    return copy.file


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


def _show_in_rerun(arguments: argparse.Namespace, logs: Sequence[log.AnyLog], stop: Stop | None) -> None:
    """Save a recording, or send it to a viewer; two runs open at the worst difference unless a frame is given."""
    target = arguments.save
    rerun = import_module("roadperc_stream.view.rerun")  # on use only, because the import takes half a second
    differences = find_differences(*logs) if len(logs) > 1 else []
    stop = stop or (differences[0].worst if differences else None)
    shown = rerun.Opening(stop, logs[1] if len(logs) > 1 else None, differences)
    overrides = parse_topic_options(arguments.topic)
    with frame_progress("writing" if target else "sending", not arguments.quiet) as progress:
        if target:
            options = {"force": arguments.force, "progress": progress, "shown": shown}
            exported = rerun.save_recording(logs[0], target, overrides, **options)
        else:
            exported = rerun.open_viewer(logs[0], overrides, progress, shown)
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
