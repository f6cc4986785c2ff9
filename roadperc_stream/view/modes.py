"""Runs the modes of roadperc-view: Rerun, Foxglove, layout, picture and video."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shlex import quote

from roadperc_stream import log
from roadperc_stream.formats.images import encode_png
from roadperc_stream.input.source import warnings_of
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas.topics import TIMES_TOPIC
from roadperc_stream.system.files import require_free, write_whole
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.time import ns_to_seconds
from roadperc_stream.view.differences import find_differences
from roadperc_stream.view.frame_times import Stop
from roadperc_stream.view.layout.filling import write_layout
from roadperc_stream.view.live import PlaybackOptions
from roadperc_stream.view.live.serving import log_with_times, serve_log
from roadperc_stream.view.pictures import picture_of
from roadperc_stream.view.video import write_video


def readable(path: Path, *, recover: bool, quiet: bool) -> log.LogFile:
    """A file that can be read repeatedly: store a pipe; with ``recover`` repair a damaged log."""
    file = log.received_file(path)
    if not recover or log.audited(file).whole:
        return file
    copy = log.repaired_copy(file)
    if not quiet:
        for warning in warnings_of(file.name, copy.salvage.damages, copy.recovery, copy.salvage.first_ns):
            print_line(f"warning: {warning}")
    return copy.file


def serve(file: log.AnyLog, stop: Stop | None, playback: PlaybackOptions, *, quiet: bool) -> None:
    """Serve a log to Foxglove, from a frame on if one is given.

    Raises:
        RoadpercError: as ``serve_log``.
    """
    if stop is not None:
        first_ns = log.summarise(file).first_ns or 0
        playback = replace(playback, start_s=ns_to_seconds(stop.log_time_ns - first_ns))
    serve_log(file, playback, quiet=quiet)


def lay_out(
    source: log.AnyLog | None, target: Path, topics: Mapping[str, str], *, live: bool, force: bool, quiet: bool
) -> None:
    """Write a Foxglove layout: of a log, of one that is served ``live``, or without a log for a live replay.

    Raises:
        RoadpercError: as ``write_layout``.
    """
    channels = log_with_times(source).channels if source is not None and live else ()
    timed = any(channel.topic == TIMES_TOPIC for channel in channels)
    write_layout(target, source, topics, timed=timed, force=force)
    if not quiet:
        print_line(f"wrote {target}")


def save_picture(source: log.AnyLog, stop: Stop, topic: str, target: Path, *, force: bool, quiet: bool) -> None:
    """Write the picture of a frame on a topic as a PNG.

    Raises:
        LogError: as ``picture_of``.
        TargetError: ``target`` exists and ``force`` is not set, or it cannot be written.
    """
    require_free(target, force=force, source=log.LogFile.of(source).name, suffix=".png")
    picture = picture_of(source, stop, topic)
    write_whole(target, encode_png(picture), force=force)
    if not quiet:
        print_line(f"wrote {target} ({picture.shape[1]}x{picture.shape[0]}, {topic} of frame {stop.frame})")


def record_video(source: log.AnyLog, target: Path, topic: str, *, force: bool, quiet: bool) -> None:
    """Write a video of a log.

    Raises:
        RoadpercError: as ``write_video``.
    """
    with frame_progress("writing", not quiet) as progress:
        video = write_video(source, target, topic, force=force, progress=progress)
    if not quiet:
        print_remarks(video.problems.first.values(), video.problems.counts)
        print_line(f"wrote {target} ({video.pictures} pictures at {video.rate_hz:.3g} Hz, of {video.frames} frames)")


def show_in_rerun(
    logs: Sequence[log.AnyLog],
    stop: Stop | None,
    target: Path | None,
    topics: Mapping[str, str],
    *,
    force: bool,
    quiet: bool,
) -> None:
    """Save one or two runs as a recording, or send them to a viewer if ``target`` is None.

    Two runs open at the worst difference unless a frame is given. ``topics`` are by role.

    Raises:
        RoadpercError: a log cannot be shown, or the file cannot be written.
    """
    from roadperc_stream.view import rerun  # noqa: PLC0415 - the import takes half a second

    differences = find_differences(*logs) if len(logs) > 1 else []
    stop = stop or (differences[0].worst if differences else None)
    shown = rerun.Opening(stop, logs[1] if len(logs) > 1 else None, differences)
    with frame_progress("writing" if target else "sending", not quiet) as progress:
        if target:
            exported = rerun.save_recording(logs[0], target, topics, force=force, progress=progress, shown=shown)
        else:
            exported = rerun.open_viewer(logs[0], topics, progress, shown)
    if quiet:
        return
    print_remarks(exported.notes, exported.problems)
    if stop is not None:
        print_line(f"opens at frame {stop.frame}; for later frames choose the timeline message_log_time")
    if target:
        frames = f" ({exported.frames} frames)" if exported.frames else ""
        print_line(f"wrote {target}{frames}; open it with: rerun {quote(str(target))}")


def print_remarks(notes: Iterable[str], problems: Mapping[str, int]) -> None:
    """Print notes, and how many messages of each topic could not be read."""
    for note in notes:
        print_line(f"note: {note}")
    for topic, count in problems.items():
        print_line(f"warning: {number(count, 'message')} on {topic} could not be read, not shown")
