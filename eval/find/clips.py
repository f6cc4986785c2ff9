"""Excerpts of logs around events, with the results: cut from the result log, or replayed as the table records it."""

import sys
from collections.abc import Mapping, Sequence
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
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import scratch_folder
from roadperc_stream.system.text import number, print_line
from roadperc_stream.system.time import TimeRange, ns_to_seconds
from roadperc_stream.view.frame_times import frame_times

from ..dataset.keys import LogKey
from ..replaying import AFTER_S, BEFORE_S, Part, kept_log, recorded_config, replayed
from ..runs import Run
from .events import Clips, Event


def write_clips(events: Sequence[Event], runs: Mapping[LogKey, Run], clips: Clips, changed: Sequence[str]) -> None:
    """Write the ``clip`` of each event, with ``BEFORE_S`` before and ``AFTER_S`` after it, and print a summary.

    ``runs`` has the run of each ``log_id`` and ``config``; ``changed`` are settings KEY=VALUE for replays.

    Raises:
        LogError: some clips cannot be written; a line gives the reason of each.
    """
    failed = 0
    for event in events:
        try:
            run = runs[event.key].table_of(event.first_frame)
            for note in _write(event, run, clips, changed):
                print_line(f"note: {event.clip}: {note}")
        except RoadpercError as error:
            failed += 1
            print_line(f"warning: no {event.clip}: {error}", sys.stderr)
    print_line(f"wrote {number(len(events) - failed, 'clip')} to {clips.folder}")
    if failed:
        raise LogError(f"{clips.folder}: {failed} of {number(len(events), 'clip')} could not be written")


def _write(event: Event, run: Run, clips: Clips, changed: Sequence[str]) -> tuple[str, ...]:
    """Write a clip; returns notes on values that differ from the recorded ones."""
    target = ReplayTarget(Path(event.clip or ""), force=clips.force)
    kept = kept_log(run)
    with scratch_folder(target.path) as folder:
        if kept is not None and not all(map(is_result, log.summarise(kept).channels)):
            target.require_writable((kept,), None, resume=False)
            _cut(kept, event, target.path, recorded_config(run, (), folder))
            return ()
        part = Part(event.peak_frame, (event.first_ns, event.last_ns), target)
        with frame_progress("clip", enabled=True) as progress:
            return replayed(run, part, parse_topic_options(clips.topics), changed, folder, progress).notes


def _cut(source: Path, event: Event, target: Path, cfg: ReplayConfig) -> None:
    """Copy the messages and the results around an event, and the calibrations and transforms that hold there."""
    first, last = event.first_frame, event.last_frame
    around = [stop.log_time_ns for frame, stop in frame_times(source).items() if first <= frame <= last]
    if not around:
        raise LogError(f"{source}: has no results of the frames {first} to {last}; it is not the log of the run")
    begin_ns = log.summarise(source).first_ns or 0
    part = TimeRange(ns_to_seconds(min(around) - begin_ns) - BEFORE_S, ns_to_seconds(max(around) - begin_ns) + AFTER_S)
    found = open_input(ReplaySource(source, time_range=part, recover=True), cfg)
    channels, window = found.summary.channels, found.messages
    topics = {channel.topic for channel in channels if is_result(channel)}
    read = log.read(found.summary, topics=topics, start_ns=window.start_ns, end_ns=window.end_ns)
    results = (message for message in read if is_result(message.channel))
    with LogWriter(target, found.summary.profile) as writer:
        for channel in channels:
            writer.register(channel)
        for message in merge(found.messages.copied(), results, key=lambda message: message.log_time_ns):
            writer.write(message)
        for attachment in found.summary.attachments:
            if attachment.name != record.STATE_ATTACHMENT:
                writer.attach(attachment)
        for metadata in found.summary.metadata:
            if metadata.name != record.METADATA_RECORD:
                writer.describe(metadata)
        old = replay_record(found.summary.metadata)
        same = {key: old[key] for key in (record.VERSION_KEY, record.SEED_KEY) if key in old}
        frames = {record.FRAMES_KEY: str(found.expected_frames)}
        writer.describe(Metadata(record.METADATA_RECORD, tuple((same | found.record() | frames).items())))
