"""What a log with results holds of one frame: the camera image, and what the chain saw in it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from roadperc_stream import log
from roadperc_stream.channels import IMAGE_SCHEMA, PRODUCER, ROLES, TAG_TABLE_KEY, Kind
from roadperc_stream.datatypes import Absent, CameraImage, Image, Lanes, Mask, Objects, TagImage
from roadperc_stream.decoding import Context, Decoded, Payload, decode
from roadperc_stream.log import Channel, Message
from roadperc_stream.semantics import CARLA_BEFORE_0_9_14

LANES, OBJECTS, DRIVABLE = "/perception/lanes", "/perception/objects", "/perception/drivable"
LATENESS_NS: Final = (0, 2_000_000_000)
"""How far a message's log time may lie from its stamp: first the window that is cheap to read is tried."""
_IMAGE_TOPICS: Final = (ROLES["image"].topic, ROLES["left"].topic)
_KINDS: Final[Mapping[str, Kind]] = {LANES: "lanes", OBJECTS: "objects", DRIVABLE: "tags"}
_MASK_CONTEXT: Final = Context(CARLA_BEFORE_0_9_14)
"""A mask's indices are no tags; the decoder wants a table all the same."""
_NOTHING: Final = Absent("not in the log")


@dataclass(frozen=True)
class SeenFrame:
    """A frame as it stands in a log with results."""

    image_bgr: Image
    lanes: Lanes | Absent
    objects: Objects | Absent
    drivable: Mask | Absent


def read_frame(path: Path, stamp_ns: int) -> SeenFrame | None:
    """The frame of a stamp, None where the log holds no camera image of it. Reads no more of the log than its part.

    The image is that of ``/camera/front/image``, else of ``/camera/left/image``, else of the first other camera: the
    one the chain saw where a log has but one.

    Raises:
        LogError: the log cannot be read.
        DecodeError: a message is not what its schema promises.
    """
    for lateness_ns in LATENESS_NS:
        found = _messages(path, stamp_ns, lateness_ns)
        image = _image(found)
        if image is not None:
            return SeenFrame(image.bgr, _lanes(found), _objects(found), _drivable(found, image.bgr))
    return None


def _messages(path: Path, stamp_ns: int, lateness_ns: int) -> dict[str, Decoded]:
    """Images and results of one stamp by topic."""
    window = log.read(path, start_ns=max(stamp_ns - lateness_ns, 0), end_ns=stamp_ns + lateness_ns + 1)
    decoded = ((message.channel.topic, _decoded(message)) for message in window)
    return {topic: content for topic, content in decoded if content and content.stamp_ns == stamp_ns}


def _decoded(message: Message) -> Decoded | None:
    kind = _kind(message.channel)
    if kind is None:
        return None
    channel = message.channel
    return decode(kind, channel.schema_name, channel.message_encoding, message.data, message.log_time_ns, _MASK_CONTEXT)


def _kind(channel: Channel) -> Kind | None:
    """What a channel is read as; None for those a picture does not need."""
    if PRODUCER in channel.metadata:
        return _KINDS.get(channel.topic)
    pictures = channel.schema_name == IMAGE_SCHEMA and channel.message_encoding == "protobuf"
    return "image" if pictures and not channel.label(TAG_TABLE_KEY) and not _is_label_image(channel.topic) else None


def _is_label_image(topic: str) -> bool:
    return topic in {role.topic for role in ROLES.values() if role.kind == "tags"}


def _image(found: Mapping[str, Decoded]) -> CameraImage | None:
    for topic in (*_IMAGE_TOPICS, *found):
        image = _payload(found, topic)
        if isinstance(image, CameraImage):
            return image
    return None


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
