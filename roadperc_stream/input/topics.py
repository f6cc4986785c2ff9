"""Finds the roles that topics could serve, by their names, schemas and first messages."""

import re
from collections.abc import Callable, Iterable
from itertools import takewhile
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.input.decoding import context_of_channel, decode, schemas_of_kind
from roadperc_stream.log import Channel, LogSummary
from roadperc_stream.model import DepthImage, TagImage
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14
from roadperc_stream.schemas.roles import CARLA_BRIDGE, CARLA_TOPICS, ROLES, Kind, Role

CAMERA_OF: Final = {
    "calibration": "image",
    "depth_calibration": "depth",
    "left_calibration": "left",
    "right_calibration": "right",
}
"""The image role that each calibration describes."""
_WORDS: Final = {
    "depth": ("depth",),
    "segmentation": ("seg", "semantic", "label"),
    "instances": ("instance",),
    "left": ("left",),
    "right": ("right",),
    "truth": ("truth",),
    "radar": ("radar",),
    "tf_static": ("static",),
}
_SIDES: Final = {"left", "right"}
_TRANSPORTS: Final = ("compressed", "compressedDepth")
"""Suffixes that ROS 2's image_transport appends to an image topic."""
ContentProbe = Callable[[Kind, Channel], bool]
"""Whether the contents of a channel are of a kind."""
_MOST_CLASSES: Final = CARLA_FROM_0_9_14
"""The table with the most classes: larger numbers are not tags in any version."""


def fits(role: Role, channel: Channel) -> bool:
    """Whether a role's kind accepts a channel's schema."""
    return (channel.schema_name, channel.message_encoding) in schemas_of_kind(role.kind)


def distinct(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics in alphabetical order."""
    return tuple(sorted({channel.topic for channel in channels}))


def known_elsewhere(role: Role, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics of CARLA's ROS bridge that belong to this role."""
    if role.name not in CARLA_TOPICS:
        return ()
    known = re.compile(f"{CARLA_BRIDGE}[^/]+/{CARLA_TOPICS[role.name]}")
    return distinct(c for c in channels if known.fullmatch(c.topic) and fits(role, c))


def fitting(role: Role, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics of the right schema whose names do not suggest another role."""
    return distinct(c for c in channels if fits(role, c) and _spoken(c.topic) == _own_words(role))


def without_a_word(role: Role, channels: Iterable[Channel]) -> tuple[Channel, ...]:
    """Channels of the right schema whose names suggest no role, except for a side."""
    return tuple(c for c in channels if fits(role, c) and _spoken(c.topic) <= _SIDES)


def beside_camera(role: Role, camera_topic: str, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Calibrations in the namespace of a camera's images that may be its own.

    A calibration whose last name suggests the camera comes before one whose last name suggests nothing. Topics without
    a namespace give no result.
    """
    parts = _without_transport(camera_topic)
    near = [c for c in channels if len(parts) > 1 and _parts(c.topic)[:-1] == parts[:-1] and fits(role, c)]
    said = {channel.topic: _spoken(_parts(channel.topic)[-1]) for channel in near}
    could = sorted(topic for topic, words in said.items() if words <= _own_words(role) | _spoken(parts[-1]))
    return tuple(topic for topic in could if said[topic]) or tuple(could)


def preferred(topics: Iterable[str], role: Role, channels: Iterable[Channel]) -> tuple[str, ...]:
    """The topics for a role, the best first: images with a calibration beside them, then names with ``front``."""
    is_camera, calibrations = role.name in CAMERA_OF.values(), (c for c in channels if fits(ROLES["calibration"], c))
    calibrated = {_namespace(channel.topic) for channel in calibrations} if is_camera else set()

    def rank(topic: str) -> tuple[bool, bool]:
        return is_camera and _namespace(topic) not in calibrated, "front" not in topic.lower()

    return tuple(sorted(topics, key=rank))


def other_side(topic: str, channels: Iterable[Channel]) -> str | None:
    """The topic with ``right`` instead of ``left`` in its name; None without one."""
    sides = {"left": "right", "Left": "Right", "LEFT": "RIGHT"}
    other = re.sub("|".join(sides), lambda found: sides[found[0]], topic)
    found = any(channel.topic == other != topic and fits(ROLES["right"], channel) for channel in channels)
    return other if found else None


def nearest(topics: tuple[str, ...], topic: str) -> tuple[str, ...]:
    """The topics that share most of another topic's namespace; all if none shares any."""
    shared = {other: shared_parts(other, topic) for other in topics}
    return tuple(other for other in topics if shared[other] == max(shared.values()))


def shared_parts(one: str, other: str) -> int:
    """Number of leading parts that the namespaces of two topics share."""
    pairs = zip(_parts(one)[:-1], _parts(other)[:-1], strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))


def _namespace(topic: str) -> tuple[str, ...]:
    return tuple(_without_transport(topic)[:-1])


def _without_transport(topic: str) -> list[str]:
    parts = _parts(topic)
    return parts[:-1] if parts[-1] in _TRANSPORTS else parts


def _parts(topic: str) -> list[str]:
    return topic.strip("/").split("/")


def _spoken(name: str) -> set[str]:
    """The roles or sides that a name suggests; ``instance_segmentation`` does not suggest class segmentation."""
    words = {word for word, signs in _WORDS.items() if any(sign in name.lower() for sign in signs)}
    return words - {"segmentation"} if "instances" in words else words


def _own_words(role: Role) -> set[str]:
    return {role.name.removesuffix("_calibration")} & _WORDS.keys()


def probe_first_message(summary: LogSummary, kind: Kind, channel: Channel) -> bool:
    """Whether the first message of a channel is depth (by its encoding) or tags (all pixels have a known class).

    False if the log or the message cannot be read. ``kind`` is ``depth`` or ``tags``.
    """
    try:
        message = next(log.read(summary, topics=(channel.topic,)), None)
        if message is None:
            return False
        found, context = message.channel, context_of_channel(message.channel, _MOST_CLASSES.name)
        schema, encoding = found.schema_name, found.message_encoding
        payload = decode(kind, schema, encoding, message.data, message.log_time_ns, context).payload
        if isinstance(payload, TagImage):
            return 0 < int(np.max(payload.tags)) < len(_MOST_CLASSES.names)  # a black image has no tags
        return isinstance(payload, DepthImage) and payload.depth_m.size > 0
    except (LogError, DecodeError):
        return False
