"""Sends a log to a Rerun viewer or writes it as a recording, message by message."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from itertools import groupby
from pathlib import Path
from typing import Final

import rerun as rr
from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import DecodeError, LogError, TargetError
from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.input.replaced import given_for, with_recorded
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import Problems, RoleAssignment
from roadperc_stream.log import LogSummary, Message
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas import topics
from roadperc_stream.schemas.row_messages import FrameMetrics
from roadperc_stream.schemas.topics import METRICS_TOPIC, RESULTS
from roadperc_stream.system.files import completing, require_free
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.time import END_OF_TIME_NS
from roadperc_stream.view.frame_times import Stop
from roadperc_stream.view.rerun.blueprint import Log, blueprint
from roadperc_stream.view.rerun.drawing import drawers
from roadperc_stream.view.rerun.pair import BASE, NEW, Opening, arrange_pair
from roadperc_stream.view.rerun.pictures import given
from roadperc_stream.view.rerun.timelines import set_log_time, time_panel
from roadperc_stream.view.rerun.tree import Entry, SceneState
from roadperc_stream.view.rerun.viewer import URL, ending_at_once, saving, start_viewer
from roadperc_stream.view.result_frames import TableTimes, nothing_shown, require_shown

FRAME: Final = "frame"
_APPLICATION: Final = "roadperc"
_LARGE_CHUNKS: Final = rr.ChunkBatcherConfig(flush_tick=timedelta(seconds=10), flush_num_bytes=16 * 2**20)
"""The footer of a recording is in memory and lists every chunk: small chunks take 0.25 MB per frame."""
_MOST_WAITING: Final = 25
"""Most log times that wait to be sent, because the queue of the sending thread is unbounded."""
Progress = Callable[[int, int], None]
ALONE: Final = Opening()


@dataclass(frozen=True)
class Exported:
    """A summary of an export, for the user."""

    frames: int
    """Number of frames; 0 without messages of frames."""
    notes: tuple[str, ...]
    problems: Mapping[str, int]


def open_viewer(
    path: log.AnyLog, overrides: Mapping[str, str], progress: Progress = no_progress, shown: Opening = ALONE
) -> Exported:
    """Open the viewer and send it a log; the viewer stays open.

    Raises:
        RoadpercError: a log is unreadable or has nothing to show, or the viewer does not start or answer.
    """
    runs = _opened(path, overrides, shown)
    start_viewer()
    recording = _recording(log.LogFile.of(path).name)
    try:
        with ending_at_once():
            recording.connect_grpc(URL)
            exported = _export(recording, runs, progress, shown, arrange_early=shown.new is None)
            recording.flush()
            recording.disconnect()  # waits until everything is sent
    except RuntimeError as error:  # raised by the SDK
        raise TargetError(f"{URL}: the viewer was closed before it had the whole log") from error
    return exported


def save_recording(
    path: log.AnyLog,
    target: Path,
    overrides: Mapping[str, str],
    *,
    force: bool = False,
    progress: Progress = no_progress,
    shown: Opening = ALONE,
) -> Exported:
    """Write a log as a Rerun recording with its blueprint; the file gets its name only when complete.

    Raises:
        RoadpercError: a log is unreadable or has nothing to show, ``target`` is not an ``.rrd`` or exists without
            ``force``, or it cannot be completed; no partial file remains.
    """
    require_free(target, force=force, source=log.LogFile.of(path).name, suffix=".rrd")
    runs = _opened(path, overrides, shown)
    recording = _recording(log.LogFile.of(path).name, _LARGE_CHUNKS)
    with completing(target, force=force) as temporary, saving(recording, temporary) as check:
        return _export(recording, runs, progress, shown, arrange_early=False, check=check)


_Run = tuple[LogSummary, RoleAssignment]


def _opened(path: log.AnyLog, overrides: Mapping[str, str], shown: Opening) -> dict[str, _Run]:
    """The runs to show, by the parent of their entities.

    Raises:
        RoadpercError: a log is unreadable or has nothing to show.
    """
    found = {}
    for root, one in ({"": path} if shown.new is None else {BASE: path, NEW: shown.new}).items():
        summary = log.summarise(one)
        found[root] = summary, assignment_of_log(summary, overrides)
        require_shown(*found[root])
    return found


def _export(
    recording: rr.RecordingStream,
    runs: Mapping[str, _Run],
    progress: Progress,
    shown: Opening,
    *,
    arrange_early: bool,
    check: Callable[[], None] = lambda: None,
) -> Exported:
    """Log one or two runs and the blueprint; ``check`` raises the errors of what was sent."""
    senders = [_Sender(recording, *run, root, shown.stop) for root, run in runs.items()]
    frames = [_send(sender, progress, check, arrange_early=arrange_early) for sender in senders]
    if shown.new is None:
        senders[0].arrange()
    else:
        arrange_pair(recording, [sender.log for sender in senders], shown)
    notes = dict.fromkeys(note for s in senders for note in (*s.roles.notes, *s.problems.first.values()))
    return Exported(frames[0], tuple(notes), {topic: n for s in senders for topic, n in s.problems.counts.items()})


def _recording(path: Path, batches: rr.ChunkBatcherConfig | None = None) -> rr.RecordingStream:
    recording = rr.RecordingStream(_APPLICATION, batcher_config=batches)
    recording.set_log_time_enabled(False)  # the time of the export is not useful
    recording.send_recording_name(path.name)
    return recording


def _send(sender: "_Sender", progress: Progress, check: Callable[[], None], *, arrange_early: bool) -> int:
    """Log all messages, and count the frames."""
    summary = sender.summary
    expected = sum(summary.counts[c.source_id] for c in summary.channels if c.topic == sender.reference)
    frames = 0
    instants = groupby(log.read(summary), key=lambda message: message.log_time_ns)
    for count, (log_time_ns, messages) in enumerate(instants, 1):
        sender.send(log_time_ns, tuple(messages))
        if count % _MOST_WAITING == 0:
            sender.recording.flush()
            check()
        if arrange_early and frames == 1 and sender.frame == 1:  # the first frame has most entities
            sender.arrange()
        frames = max(frames, sender.frame + 1)
        progress(frames, expected)
    if not sender.entities:
        raise nothing_shown(summary.path, sender.problems.first.values())
    return frames


class _Sender:
    """Sends messages to a recording and clears results that a frame lacks."""

    def __init__(
        self, recording: rr.RecordingStream, summary: LogSummary, roles: RoleAssignment, root: str, stop: Stop | None
    ) -> None:
        self.recording, self.summary, self.roles, self._root, self._stop = recording, summary, roles, root, stop
        self.reference = roles.topics.get(roles.reference or "")
        """Topic whose messages are counted as frames in a log without metrics; None if absent."""
        self.frame = -1
        """Number of the current frame from 0; -1 before the first one."""
        cfg = with_recorded(ReplayConfig(), summary.attachments, summary.path)
        state = SceneState(roles.reference or "", given_for(summary, roles, cfg))
        self._given = list(given(roles.topics, state))
        self._drawers = drawers(summary.channels, roles, state, TableTimes(sidecar_path(summary.path, "metrics")).of)
        self._contexts: dict[str, rr.AsComponents] = {}
        self._drawn: set[str] = set()
        self.entities: set[str] = set()
        """Paths of the sent entities, without the root."""
        self.problems = Problems()

    @property
    def log(self) -> Log:
        """The sent contents of the log."""
        return Log(self.roles.topics, frozenset(self.entities), self._root)

    def arrange(self) -> None:
        """Send the blueprint for the sent entities."""
        self.recording.send_blueprint(blueprint(self.log, time_panel(self._stop)))

    def send(self, log_time_ns: int, messages: Sequence[Message]) -> None:
        """Log all messages of one log time.

        Raises:
            LogError: Rerun cannot show the time.
        """
        if log_time_ns >= END_OF_TIME_NS:
            raise LogError(f"log time {log_time_ns} ns: expected less than 2^63, the limit of Rerun")
        metrics = [message for message in messages if is_result_of(message.channel, METRICS_TOPIC)]
        self.frame = self._frame_of(messages, metrics)
        set_log_time(self.recording, log_time_ns, self._stop)
        self.recording.set_time(FRAME, sequence=max(self.frame, 0))  # earlier messages belong to the first frame
        entries, self._given = [*self._given, *self._entries(messages)], []
        for entry in entries:
            self._log(entry)
        if metrics:  # every frame of a result has metrics
            of_frame = {e.entity for e in entries if e.frame and e.entity.startswith(tuple(RESULTS))}
            # The viewer shows the last value: clear results that this frame lacks.
            for entity in sorted(self._drawn - of_frame):
                self.recording.log(f"{self._root}{entity}", rr.Clear(recursive=False))
            self._drawn = of_frame

    def _frame_of(self, messages: Sequence[Message], metrics: Sequence[Message]) -> int:
        """The frame number of the metrics; without metrics, count the reference messages."""
        for message in metrics:
            with suppress(ProtobufError):  # drawing it reports the damage
                return int(FrameMetrics.FromString(message.data).frame)
        return self.frame + any(message.channel.topic == self.reference for message in messages)

    def _entries(self, messages: Iterable[Message]) -> Iterator[Entry]:
        for message in messages:
            drawer = self._drawers.get(message.channel)
            try:
                yield from drawer(message) if drawer else ()
            except DecodeError as error:
                self.problems.add(message.channel.topic, message.log_time_ns, error)

    def _log(self, entry: Entry) -> None:
        is_frame = isinstance(entry.archetype, rr.Transform3D | rr.Pinhole)
        is_result = entry.entity.startswith(topics.RESULT_PREFIX) and not is_frame
        if self._root == NEW and not is_result:  # inputs and frames come from the base
            return
        self.entities.add(entry.entity)
        path = f"{self._root}{entry.entity}"
        if isinstance(entry.archetype, rr.AnnotationContext):
            if entry.entity not in self._contexts:  # one context is valid for the whole recording
                self._contexts[entry.entity] = entry.archetype
                self.recording.log(path, entry.archetype, static=True)
        else:
            frame = (rr.CoordinateFrame(entry.frame),) if entry.frame else ()
            self.recording.log(path, entry.archetype, *frame)
