"""Runs the modes of roadperc-view: Rerun, Foxglove, layout and video."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import quote

from roadperc_stream import log
from roadperc_stream.input.source import warnings_of
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas.topics import TIMES_TOPIC
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.time import ns_to_seconds
from roadperc_stream.view.differences import find_differences
from roadperc_stream.view.frame_times import Stop
from roadperc_stream.view.layout.filling import write_layout
from roadperc_stream.view.live import PlaybackOptions
from roadperc_stream.view.live.serving import log_with_times, serve_log
from roadperc_stream.view.video import write_video


@dataclass(frozen=True)
class ViewOptions:
    """Where a log is shown: in the Rerun viewer unless one of the outputs is set; ``topics`` by role as in a replay."""

    topics: Mapping[str, str] = field(default_factory=dict)
    save: Path | None = None
    video: Path | None = None
    layout: Path | None = None
    foxglove: bool = False
    playback: PlaybackOptions = field(default_factory=PlaybackOptions)
    force: bool = False
    quiet: bool = False


def view(logs: Sequence[log.AnyLog], stop: Stop | None, options: ViewOptions) -> None:
    """Show one or two logs from a frame on, or write a layout, a recording or a video; no log gives a general layout.

    Raises:
        RoadpercError: a log cannot be shown, or a file cannot be written.
    """
    if options.layout:
        _lay_out(logs[0] if logs else None, options.layout, options)
    if options.foxglove:
        playback = options.playback
        if stop is not None:
            first_ns = log.summarise(logs[0]).first_ns or 0
            playback = replace(playback, start_s=ns_to_seconds(stop.log_time_ns - first_ns))
        serve_log(logs[0], playback, quiet=options.quiet)
    elif options.layout:
        return
    elif options.video:
        _record_video(logs[0], options.video, options)
    else:
        _show_in_rerun(logs, stop, options)


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


def _lay_out(source: log.AnyLog | None, path: Path, options: ViewOptions) -> None:
    channels = log_with_times(source).channels if source is not None and options.foxglove else ()
    timed = any(channel.topic == TIMES_TOPIC for channel in channels)
    write_layout(path, source, options.topics, timed=timed, force=options.force)
    if not options.quiet:
        print_line(f"wrote {path}")


def _record_video(source: log.AnyLog, path: Path, options: ViewOptions) -> None:
    with frame_progress("writing", not options.quiet) as progress:
        video = write_video(source, path, force=options.force, progress=progress)
    if not options.quiet:
        print_remarks(video.problems.first.values(), video.problems.counts)
        print_line(f"wrote {path} ({video.pictures} pictures at {video.rate_hz:.3g} Hz, of {video.frames} frames)")


def _show_in_rerun(logs: Sequence[log.AnyLog], stop: Stop | None, options: ViewOptions) -> None:
    """Save a recording, or send it to a viewer; two runs open at the worst difference unless a frame is given."""
    from roadperc_stream.view import rerun  # noqa: PLC0415 - the import takes half a second

    differences = find_differences(*logs) if len(logs) > 1 else []
    stop = stop or (differences[0].worst if differences else None)
    shown = rerun.Opening(stop, logs[1] if len(logs) > 1 else None, differences)
    target, topics = options.save, options.topics
    with frame_progress("writing" if target else "sending", not options.quiet) as progress:
        if target:
            exported = rerun.save_recording(
                logs[0], target, topics, force=options.force, progress=progress, shown=shown
            )
        else:
            exported = rerun.open_viewer(logs[0], topics, progress, shown)
    if options.quiet:
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
