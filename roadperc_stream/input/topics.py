"""What names, schemas and first messages say of the roles that topics could serve."""

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
from roadperc_stream.schemas.roles import CARLA_BRIDGE, CARLA_TOPICS, Kind, Role

CAMERA_OF: Final = {
    "calibration": "image",
    "depth_calibration": "depth",
    "left_calibration": "left",
    "right_calibration": "right",
}
"""Whose images a calibration speaks of."""
_WORDS: Final = {
    "depth": ("depth",),
    "segmentation": ("seg", "semantic", "label"),
    "instances": ("instance",),
    "left": ("left",),
    "right": ("right",),
    "truth": ("truth",),
    "tf_static": ("static",),
}
_SIDES: Final = {"left", "right"}
_TRANSPORTS: Final = ("compressed", "compressedDepth")
"""What ROS 2's image_transport appends to the topic of a camera's images."""
ContentProbe = Callable[[Kind, Channel], bool]
"""Whether what is in a channel is of a kind."""
_MOST_CLASSES: Final = CARLA_FROM_0_9_14
"""The table with most classes: a number beyond is no tag of any version."""


def fits(role: Role, channel: Channel) -> bool:
    """Whether a channel's schema is one of the role's kind."""
    return (channel.schema_name, channel.message_encoding) in schemas_of_kind(role.kind)


def distinct(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics in alphabetical order."""
    return tuple(sorted({channel.topic for channel in channels}))


def known_elsewhere(role: Role, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics of CARLA's ROS bridge that are known to be this role's."""
    if role.name not in CARLA_TOPICS:
        return ()
    known = re.compile(f"{CARLA_BRIDGE}[^/]+/{CARLA_TOPICS[role.name]}")
    return distinct(c for c in channels if known.fullmatch(c.topic) and fits(role, c))


def fitting(role: Role, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics of the right schema whose names do not speak of another role."""
    return distinct(c for c in channels if fits(role, c) and _spoken(c.topic) == _own_words(role))


def without_a_word(role: Role, channels: Iterable[Channel]) -> tuple[Channel, ...]:
    """Channels of the right schema whose names speak of no role but a side: what they hold their names do not say."""
    return tuple(c for c in channels if fits(role, c) and _spoken(c.topic) <= _SIDES)


def beside_camera(role: Role, camera_topic: str, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Calibrations in the namespace of a camera's images which its own could be.

    Those whose last name speaks of the camera, else those whose last name speaks of nothing; the namespace is that of
    the camera whatever it is called. Topics without a namespace say nothing.
    """
    parts = _parts(camera_topic)
    parts = parts[:-1] if parts[-1] in _TRANSPORTS else parts
    near = [c for c in channels if len(parts) > 1 and _parts(c.topic)[:-1] == parts[:-1] and fits(role, c)]
    said = {channel.topic: _spoken(_parts(channel.topic)[-1]) for channel in near}
    could = sorted(topic for topic, words in said.items() if words <= _own_words(role) | _spoken(parts[-1]))
    return tuple(topic for topic in could if said[topic]) or tuple(could)


def nearest(topics: tuple[str, ...], topic: str) -> tuple[str, ...]:
    """Those that share most of another topic's namespace; all where none shares any."""
    shared = {other: shared_parts(other, topic) for other in topics}
    return tuple(other for other in topics if shared[other] == max(shared.values()))


def shared_parts(one: str, other: str) -> int:
    """How many parts of their namespaces two topics have in common, from the first on."""
    pairs = zip(_parts(one)[:-1], _parts(other)[:-1], strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))


def _parts(topic: str) -> list[str]:
    return topic.strip("/").split("/")


def _spoken(name: str) -> set[str]:
    """The roles, or sides, that a name speaks of; an ``instance_segmentation`` is none of classes."""
    words = {word for word, signs in _WORDS.items() if any(sign in name.lower() for sign in signs)}
    return words - {"segmentation"} if "instances" in words else words


def _own_words(role: Role) -> set[str]:
    return {role.name.removesuffix("_calibration")} & _WORDS.keys()


def probe_first_message(summary: LogSummary, kind: Kind, channel: Channel) -> bool:
    """Whether the first message of a channel is depth, or tags: by its encoding, and by pixels that are all some class.

    A log, or a message, that cannot be read says nothing.

    Args:
        summary: the log.
        kind: ``depth`` or ``tags``.
        channel: of the log.
    """
    try:
        message = next(log.read(summary, topics=(channel.topic,)), None)
        if message is None:
            return False
        found, context = message.channel, context_of_channel(message.channel, _MOST_CLASSES.name)
        schema, encoding = found.schema_name, found.message_encoding
        payload = decode(kind, schema, encoding, message.data, message.log_time_ns, context).payload
        if isinstance(payload, TagImage):
            return 0 < int(np.max(payload.tags)) < len(_MOST_CLASSES.names)  # a black image is no tags
        return isinstance(payload, DepthImage) and payload.depth_m.size > 0
    except (LogError, DecodeError):
        return False
