"""What a log with results holds of its frames: the camera image, and what the chain saw in it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

from roadperc_stream import log
from roadperc_stream.channels import METRICS_TOPIC, ROLES, TAG_TABLE_KEY, Kind
from roadperc_stream.datatypes import Absent, CameraImage, Image, Lanes, Mask, Objects, TagImage
from roadperc_stream.decoding import Decoded, Payload, context_of_channel, decode, schemas_of_kind
from roadperc_stream.errors import DecodeError
from roadperc_stream.log import Channel, Message
from roadperc_stream.results import decode_metrics
from roadperc_stream.roles import Problems, is_result, is_result_of
from roadperc_stream.rows import FrameMetrics
from roadperc_stream.semantics import CARLA_BEFORE_0_9_14

Content = TypeVar("Content")
LANES, OBJECTS, DRIVABLE = "/perception/lanes", "/perception/objects", "/perception/drivable"
LATENESS_NS: Final = (0, 2_000_000_000)
"""How far a message's log time may lie from its stamp: first the window that is cheap to read is tried."""
_IMAGE_TOPICS: Final = (ROLES["image"].topic, ROLES["left"].topic)
_KINDS: Final[Mapping[str, Kind]] = {LANES: "lanes", OBJECTS: "objects", DRIVABLE: "tags"}
_NOTHING: Final = Absent("not in the log")
_NO_PICTURES: Final = ("depth", "seg", "semantic", "label")
"""Words in the topics of images that are no camera's."""
_MOST_WAITING: Final = 64
"""Instants that wait for their metrics at a time: of a sensor that is no frame's they never come."""


@dataclass(frozen=True)
class SeenFrame:
    """A frame as it stands in a log with results."""

    image_bgr: Image
    lanes: Lanes | Absent
    objects: Objects | Absent
    drivable: Mask | Absent


def read_frame(path: Path, stamp_ns: int, problems: Problems) -> SeenFrame | None:
    """The frame of a stamp, None where the log holds no camera image of it. Reads no more of the log than its part.

    The image is that of ``/camera/front/image``, else of ``/camera/left/image``, else of the first other camera, a
    pair's right one excepted: the one the chain saw where a log has but one. What cannot be read is not there.

    Args:
        path: the log.
        stamp_ns: of the frame.
        problems: filled in; a message that is met twice, near two frames, counts twice.

    Raises:
        LogError: the log cannot be read.
    """
    for lateness_ns in LATENESS_NS:
        seen = _seen(_messages(path, stamp_ns, lateness_ns, problems), stamp_ns, problems)
        if seen is not None:
            return seen
    return None


def read_frames(path: Path, problems: Problems) -> Iterator[tuple[FrameMetrics, SeenFrame | None]]:
    """Every frame's row and what is there of it, None without a camera image; in order, a few in memory at a time.

    Frames whose row cannot be read are left out, and of the others what cannot be.

    Args:
        path: the log.
        problems: filled in.

    Raises:
        LogError: the log cannot be read.
    """
    channels = log.summarise(path).channels
    topics = {channel.topic for channel in channels if _kind(channel) or is_result_of(channel, METRICS_TOPIC)}
    waiting: dict[int, dict[str, Decoded]] = {}
    for message in log.read(path, topics=topics):
        if row := row_of(message, problems):
            yield row, _seen(waiting.pop(row.stamp_ns, {}), row.stamp_ns, problems)
            waiting = {stamp_ns: found for stamp_ns, found in waiting.items() if stamp_ns > row.stamp_ns}
        elif content := _decoded(message, problems):
            waiting.setdefault(content.stamp_ns, {})[message.channel.topic] = content
            if len(waiting) > _MOST_WAITING:
                waiting.pop(next(iter(waiting)))


def read_rows(path: Path, problems: Problems) -> Iterator[FrameMetrics]:
    """Every frame's row that can be read, in order; none of a log without results.

    Args:
        path: the log.
        problems: filled in.

    Raises:
        LogError: the log cannot be read.
    """
    rows = (row_of(message, problems) for message in log.read(path, topics=(METRICS_TOPIC,)))
    return (row for row in rows if row is not None)


def row_of(message: Message, problems: Problems) -> FrameMetrics | None:
    """A frame's row; None of a message that is none, or cannot be read, which is counted."""
    if not is_result_of(message.channel, METRICS_TOPIC):
        return None
    return content_of(lambda: decode_metrics(message.data), METRICS_TOPIC, message.log_time_ns, problems)


def content_of(content: Callable[[], Content], topic: str, time_ns: int, problems: Problems) -> Content | None:
    """What a message holds; None, and counted, where it cannot be read."""
    try:
        return content()
    except DecodeError as error:
        problems.add(topic, time_ns, error)
        return None


def _seen(found: Mapping[str, Decoded], stamp_ns: int, problems: Problems) -> SeenFrame | None:
    topic, image = _image(found)
    if image is None:
        return None
    image_bgr = content_of(lambda: image.bgr, topic, stamp_ns, problems)
    if image_bgr is None:
        return None
    drivable = content_of(lambda: _drivable(found, image_bgr), DRIVABLE, stamp_ns, problems)
    return SeenFrame(image_bgr, _lanes(found), _objects(found), _NOTHING if drivable is None else drivable)


def _messages(path: Path, stamp_ns: int, lateness_ns: int, problems: Problems) -> dict[str, Decoded]:
    """Images and results of one stamp by topic."""
    window = log.read(path, start_ns=max(stamp_ns - lateness_ns, 0), end_ns=stamp_ns + lateness_ns + 1)
    decoded = ((message.channel.topic, _decoded(message, problems)) for message in window)
    return {topic: content for topic, content in decoded if content and content.stamp_ns == stamp_ns}


def _decoded(message: Message, problems: Problems) -> Decoded | None:
    channel, log_time_ns = message.channel, message.log_time_ns
    kind = _kind(channel)
    if kind is None:
        return None
    # A mask's indices are no tags; the decoder wants a table all the same.
    context = replace(context_of_channel(channel, "auto"), tag_table=CARLA_BEFORE_0_9_14)
    schema, encoding = channel.schema_name, channel.message_encoding
    return content_of(
        lambda: decode(kind, schema, encoding, message.data, log_time_ns, context),
        channel.topic,
        log_time_ns,
        problems,
    )


def _kind(channel: Channel) -> Kind | None:
    """What a channel is read as; None for those a picture does not need."""
    if is_result(channel):
        return _KINDS.get(channel.topic) if is_result_of(channel, channel.topic) else None
    pictures = (channel.schema_name, channel.message_encoding) in schemas_of_kind("image")
    return "image" if pictures and not channel.label(TAG_TABLE_KEY) and not _is_no_picture(channel.topic) else None


def _is_no_picture(topic: str) -> bool:
    others = {role.topic for role in ROLES.values() if role.kind == "tags" or role.name == "right"}
    return topic in others or any(word in topic.lower() for word in _NO_PICTURES)


def _image(found: Mapping[str, Decoded]) -> tuple[str, CameraImage | None]:
    for topic in (*_IMAGE_TOPICS, *found):
        image = _payload(found, topic)
        if isinstance(image, CameraImage):
            return topic, image
    return "", None


def _lanes(found: Mapping[str, Decoded]) -> Lanes | Absent:
    lanes = _payload(found, LANES)
    return lanes if isinstance(lanes, Lanes) else _NOTHING


def _objects(found: Mapping[str, Decoded]) -> Objects | Absent:
    objects = _payload(found, OBJECTS)
    return objects if isinstance(objects, Objects) else _NOTHING


def _drivable(found: Mapping[str, Decoded], image_bgr: Image) -> Mask | Absent:
    """The mask, unless it belongs to another camera than the image."""
    tags = _payload(found, DRIVABLE)
    if not isinstance(tags, TagImage) or tags.tags.shape != image_bgr.shape[:2]:
        return _NOTHING
    return tags.tags > 0


def _payload(found: Mapping[str, Decoded], topic: str) -> Payload | None:
    return found[topic].payload if topic in found else None
