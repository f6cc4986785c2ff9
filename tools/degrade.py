"""Write a log with corruptions: of known names and severities, the same bytes for the same seed, the truth kept."""

import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from typing import Any, Final

from roadperc_stream import __version__, log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError, DecodeError
from roadperc_stream.formats.images import encode_indices, encode_jpeg, encode_png
from roadperc_stream.geometry import Camera
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.replaced import first_latched, with_recorded
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import Problems, RoleAssignment, decoded_messages
from roadperc_stream.log import Channel, LogSummary, LogWriter, Message, Metadata
from roadperc_stream.model import CameraImage, DepthImage, TagImage
from roadperc_stream.output import encoding
from roadperc_stream.output.input_log import channel_of
from roadperc_stream.schemas import record
from roadperc_stream.schemas.roles import ROLES, Kind
from roadperc_stream.system.files import completing
from roadperc_stream.system.progress import Progress, no_progress
from roadperc_stream.system.threads import in_order, one_thread, usable_cores

from .corruptions.draw import Draw
from .corruptions.levels import LEVELS
from .corruptions.sensors import CONTENTS, DELIVERIES
from .log_copy import copy_records
from .recording import JPEG_QUALITY

_SENSORS: Final[tuple[Kind, ...]] = ("image", "tags", "instances", "depth", "points", "detections")
_READ: Final[tuple[Kind, ...]] = (*_SENSORS, "tf")
_TRUTH_OF: Final = {"depth": "truth_depth", "segmentation": "truth_segmentation"}
_PIXELS: Final = {"image": "bgr", "depth": "depth_m", "tags": "tags"}
"""The attribute of the payload that holds the pixels, by kind."""


@dataclass(frozen=True)
class Degradation:
    """A log, the roles that may change, and the corruptions in their order with severities of 1 or more.

    ``truths`` are the topics whose messages are also written unchanged as truth, each with the topic of the truth.
    """

    summary: LogSummary
    roles: RoleAssignment
    cameras: tuple[Camera, ...]
    severities: Mapping[str, int]
    seed: int
    truths: Mapping[str, str]

    def parameters(self, name: str, item: Stamped) -> tuple[Any, Draw]:
        """The constants of a corruption, and the random numbers for a message."""
        first_ns, last_ns = self.summary.first_ns or 0, self.summary.last_ns or 0
        share = (item.log_time_ns - first_ns) / max(last_ns - first_ns, 1)
        draw = Draw(self.seed, name, item.stamp_ns, item.role, share, self.cameras)
        return LEVELS[name][self.severities[name] - 1], draw


def degrade_log(
    source: Path,
    out: Path,
    severities: Mapping[str, int],
    seed: int,
    overrides: Mapping[str, str],
    progress: Progress = no_progress,
) -> list[str]:
    """Write a log with corruptions and return warnings; without any of severity 1 or more, copy its bytes.

    Raises:
        RoadpercError: the input or the output cannot be used, or the log has nothing that a corruption changes.
    """
    summary = log.summarise(source)
    job = _job(summary, {name: found for name, found in severities.items() if found}, seed, overrides)
    if not job.severities:
        with completing(out) as temporary:
            shutil.copyfile(source, temporary)
        return []
    with one_thread(), LogWriter(out, summary.profile) as target:
        for channel in summary.channels:
            if not is_result(channel):
                target.register(channel, keep_ids=True)
        unreadable = _write(job, target, progress)
        _describe(job, target)
    return [f"{text}; unreadable messages on this topic stay unchanged" for text in unreadable.values()]


def _job(summary: LogSummary, severities: Mapping[str, int], seed: int, overrides: Mapping[str, str]) -> Degradation:
    """Find what the corruptions change.

    Raises:
        ChannelError: a corruption changes nothing in this log.
    """
    assigned = assignment_of_log(summary, overrides)
    read = {
        role: topic for role, topic in assigned.topics.items() if ROLES[role].kind in _READ and not ROLES[role].truth
    }
    roles, kinds = replace(assigned, topics=read), {ROLES[role].kind for role in read}
    for name in severities:
        changed = {kind for kind, changes in CONTENTS.items() if name in changes} or set(_SENSORS)
        if not changed & kinds:
            raise ChannelError(f"{summary.path}: {name} changes nothing: no channel of {' or '.join(sorted(changed))}")
    touched = {ROLES[role].kind for role in _TRUTH_OF if severities.keys() & {*CONTENTS[ROLES[role].kind], *DELIVERIES}}
    truths = {
        topic: ROLES[_TRUTH_OF[role]].topic
        for role, topic in roles.topics.items()
        if role in _TRUTH_OF and ROLES[role].kind in touched and _TRUTH_OF[role] not in assigned.topics
    }
    return Degradation(summary, roles, _cameras(summary, assigned), severities, seed, truths)


def _cameras(summary: LogSummary, roles: RoleAssignment) -> tuple[Camera, ...]:
    """The first calibration of each camera, the front camera's first.

    Raises:
        ChannelError: there is none.
    """
    cameras = first_latched(summary, roles).cameras
    if not cameras:
        raise ChannelError(f"{summary.path}: no calibration of a camera")
    return tuple(cameras[role] for role in ROLES if role in cameras)


def _write(job: Degradation, target: LogWriter, progress: Progress) -> dict[str, str]:
    """Write what the messages become, in log-time order; return a text about the first unreadable one of each topic."""
    messages = (message for message in log.read(job.summary) if not is_result(message.channel))
    unreadable: dict[str, str] = {}
    waiting: list[tuple[int, int, Message]] = []
    serial, total = count(), sum(job.summary.counts.values())
    for done, (time_ns, group, first) in enumerate(in_order(partial(_corrupted, job), messages, usable_cores()), 1):
        while waiting and waiting[0][0] < time_ns:
            target.write(heappop(waiting)[2])
        for message in group:
            heappush(waiting, (message.log_time_ns, next(serial), message))
        unreadable = first | unreadable
        progress(done, total)
    for _, _, message in sorted(waiting, key=lambda item: item[:2]):
        target.write(message)
    return unreadable


def _corrupted(job: Degradation, message: Message) -> tuple[int, list[Message], dict[str, str]]:
    """A message's log time, what it becomes, and a text by its topic if it cannot be read.

    It becomes a clean copy as truth if the log has none, and the message as often as it arrives.
    """
    time_ns, topic, problems = message.log_time_ns, message.channel.topic, Problems()
    item = next(decoded_messages([message], job.roles, problems=problems), None)
    group = [message]
    if item is not None:
        delays, changed = _delays(job, item), message
        try:
            changed = _changed(job, message, item) if delays else message
        except DecodeError as error:
            problems.add(topic, time_ns, error)
        group = [replace(changed, log_time_ns=time_ns + delay) for delay in delays]
        if topic in job.truths:
            group.insert(0, replace(message, channel=replace(message.channel, topic=job.truths[topic])))
    return time_ns, group, problems.first


def _delays(job: Degradation, item: Stamped) -> list[int]:
    """How late a message arrives each time, in nanoseconds."""
    kind, delays = ROLES[item.role].kind, [0]
    for name in job.severities:
        if name in DELIVERIES and kind in _SENSORS:
            more = DELIVERIES[name](kind, *job.parameters(name, item))
            delays = [delay + later for delay in delays for later in more]
    return delays


def _changed(job: Degradation, message: Message, item: Stamped) -> Message:
    """The message with changed content; the message itself if no corruption changes it."""
    kind = ROLES[item.role].kind
    names = [name for name in job.severities if name in CONTENTS.get(kind, {})]
    if not names:
        return message
    before = content = getattr(item.payload, _PIXELS[kind]) if kind in _PIXELS else item.payload
    for name in names:
        content = CONTENTS[kind][name](content, *job.parameters(name, item))
    channel = _own_channel(message.channel, item)
    if content is before and channel is message.channel:
        return message
    return replace(message, channel=channel, data=_encoded(job, item, content))


def _own_channel(channel: Channel, item: Stamped) -> Channel:
    """The channel for messages of this program: the message's own, if it has the schema that they are written with."""
    table = item.payload.table if isinstance(item.payload, TagImage) else None
    own = replace(channel_of(item.role, table), topic=channel.topic, source_id=channel.source_id)
    return channel if own.schema == channel.schema and set(own.metadata) <= set(channel.metadata) else own


def _encoded(job: Degradation, item: Stamped, content: Any) -> bytes:
    stamp_ns, payload = item.stamp_ns, item.payload
    match payload:
        case CameraImage():
            if payload.lossless:
                return encoding.encode_image(stamp_ns, payload.frame_id, "png", encode_png(content))
            return encoding.encode_image(stamp_ns, payload.frame_id, "jpeg", encode_jpeg(content, JPEG_QUALITY))
        case DepthImage():
            as_float = payload.limit_m == math.inf
            return encoding.encode_depth(stamp_ns, payload.frame_id, content, as_float=as_float)
        case TagImage():
            png = encode_indices(content, payload.table.colours)
            return encoding.encode_image(stamp_ns, payload.frame_id, "png", png)
    if ROLES[item.role].kind == "tf":
        return encoding.encode_transforms(stamp_ns, content)
    return encoding.encode_detections(stamp_ns, job.cameras[0].frame_id, content)


def _describe(job: Degradation, target: LogWriter) -> None:
    """Copy attachments and metadata, and record the corruptions."""
    copy_records(job.summary, target, with_recorded(ReplayConfig(), job.summary.attachments, job.summary.path))
    values = {name: str(severity) for name, severity in job.severities.items()}
    values |= {record.SEED_KEY: str(job.seed), record.VERSION_KEY: __version__}
    target.describe(Metadata(record.DEGRADATION_RECORD, tuple(values.items())))
