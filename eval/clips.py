"""Excerpts of logs around events, with the results: cut from the result log, or replayed as the table records it."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from heapq import merge
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import LogError, RoadpercError
from roadperc_stream.input import ReplaySource, open_input
from roadperc_stream.input.earlier_replay import is_result, replay_record
from roadperc_stream.log import LogWriter, Metadata
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.terminal import frame_progress
from roadperc_stream.schemas import record
from roadperc_stream.system.progress import Progress
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.time import TimeRange, ns_to_seconds
from roadperc_stream.view.frame_times import frame_times

from .dataset.worst import LogKey
from .frame_replay import AFTER_S, BEFORE_S, kept_log, recorded_config, recorded_replay
from .runs import Run


@dataclass(frozen=True)
class Clip:
    """An excerpt to write: its file, its log, and the first frame, the last frame and the peak of its event."""

    path: Path
    key: LogKey
    frames: tuple[int, int, int]


def write_clips(clips: Sequence[Clip], runs: Mapping[LogKey, Run], arguments: argparse.Namespace) -> None:
    """Write excerpts with ``BEFORE_S`` before and ``AFTER_S`` after the event, and print what was written.

    Raises:
        RoadpercError: some excerpts cannot be written; a line gives the reason of each.
    """
    failed = 0
    for clip in clips:
        try:
            with frame_progress(clip.path.name, enabled=True) as progress, ExitStack() as files:
                notes = _write(clip, runs[clip.key].table_of(clip.frames[0]), arguments, files, progress)
            for note in notes:
                print_line(f"note: {clip.path}: {note}")
        except RoadpercError as error:
            failed += 1
            print_line(f"warning: {clip.path} was not written: {error}", sys.stderr)
    print_line(f"wrote {number(len(clips) - failed, 'clip')} to {arguments.clips}")
    if failed:
        raise LogError(f"{arguments.clips}: {failed} of {number(len(clips), 'clip')} were not written")


def _write(
    clip: Clip, run: Run, arguments: argparse.Namespace, files: ExitStack, progress: Progress
) -> tuple[str, ...]:
    """Write an excerpt; returns notes on values that differ from the recorded ones."""
    target = ReplayTarget(clip.path, force=arguments.force)
    kept = kept_log(run)
    if kept is not None and not all(map(is_result, log.summarise(kept).channels)):
        target.require_writable((kept,), None, resume=False)
        _cut(kept, clip, recorded_config(run, (), files))
        return ()
    return recorded_replay(run, arguments.topic, arguments.set, files).excerpt(clip.frames, target, progress).notes


def _cut(source: Path, clip: Clip, cfg: ReplayConfig) -> None:
    """Copy the messages and the results around an event, and the calibrations and transforms that hold there."""
    first, last, _ = clip.frames
    around = [ns for frame, ns in frame_times(source).items() if first <= frame <= last]
    if not around:
        raise LogError(f"{source}: has no results of the frames {first} to {last}; it is not the log of the run")
    begin_ns = log.summarise(source).first_ns or 0
    part = TimeRange(ns_to_seconds(min(around) - begin_ns) - BEFORE_S, ns_to_seconds(max(around) - begin_ns) + AFTER_S)
    found = open_input(ReplaySource(source, time_range=part, recover=True), cfg)
    channels, window = found.summary.channels, found.plan.window
    topics = {channel.topic for channel in channels if is_result(channel)}
    read = log.read(found.summary, topics=topics, start_ns=window.start_ns, end_ns=window.end_ns)
    results = (message for message in read if is_result(message.channel))
    with LogWriter(clip.path, found.summary.profile) as writer:
        for channel in channels:
            writer.register(channel)
        for message in merge(found.messages(), results, key=lambda message: message.log_time_ns):
            writer.write(message)
        for attachment in found.summary.attachments:
            if attachment.name not in (record.STATE_ATTACHMENT, record.BEGIN_ATTACHMENT):
                writer.attach(attachment)
        for metadata in found.summary.metadata:
            if metadata.name != record.METADATA_RECORD:
                writer.describe(metadata)
        old = replay_record(found.summary.metadata)
        same = {key: old[key] for key in (record.VERSION_KEY, record.SEED_KEY) if key in old}
        frames = {record.FRAMES_KEY: str(found.expected_frames)}
        writer.describe(Metadata(record.METADATA_RECORD, tuple((same | found.record() | frames).items())))
