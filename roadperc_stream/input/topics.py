"""Finds the topics that could serve a role, by their schemas, names and namespaces."""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import takewhile
from typing import Final

from roadperc_stream.input.decoding import schemas_of_kind
from roadperc_stream.log import Channel
from roadperc_stream.schemas.roles import CARLA_BRIDGE, CARLA_TOPICS, ROLES, Role

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
_TRANSPORTS: Final = ("compressed", "compressedDepth")
"""Suffixes that ROS 2's image_transport appends to an image topic."""


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


def could_serve(role: Role, inputs: Sequence[Channel], topics: Mapping[str, str]) -> tuple[str, ...]:
    """Topics that may be a role's, the best first. A calibration may be assigned to another camera already.

    Images with a calibration beside them come first, then names with ``front``. ``topics`` are those of assigned roles.
    """
    if CAMERA_OF.get(role.name) in topics:
        return _calibrations(role, inputs, topics)
    free = [channel for channel in inputs if channel.topic not in topics.values()]
    if role.name == "right" and "left" in topics:
        return _other_side(topics["left"], free)
    is_camera = role.name in CAMERA_OF.values()
    calibrated = {_namespace(c.topic) for c in inputs if is_camera and fits(ROLES["calibration"], c)}

    def rank(topic: str) -> tuple[bool, bool]:
        return is_camera and _namespace(topic) not in calibrated, "front" not in topic.lower()

    return tuple(sorted(_fitting(role, free), key=rank))


def nearest(topics: Sequence[str], camera_topic: str) -> Sequence[str]:
    """The topics that share most of a camera's namespace; all if none shares any."""
    shared = {topic: _shared_parts(topic, camera_topic) for topic in topics}
    return [topic for topic in topics if shared[topic] == max(shared.values())]


def _calibrations(role: Role, inputs: Sequence[Channel], topics: Mapping[str, str]) -> tuple[str, ...]:
    """Calibrations in the namespace of a camera's images, else those whose names match.

    A calibration beside another camera does not count. A depth camera may share the image's calibration.
    """
    others = {name: camera for name, camera in CAMERA_OF.items() if name != role.name and camera in topics}
    if role.name == "calibration":
        others.pop("depth_calibration", None)
    theirs = {t for name, camera in others.items() for t in _beside(ROLES[name], topics[camera], inputs)}
    beside = _beside(role, topics[CAMERA_OF[role.name]], inputs)
    if len(beside) == 1 and beside[0] in theirs:
        return ()
    taken = theirs | set(topics.values())
    return beside or _fitting(role, (c for c in inputs if c.topic not in taken))


def _beside(role: Role, camera_topic: str, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Calibrations in the namespace of a camera's images that may be its own.

    Those whose last name suggests the camera exclude those whose last name suggests nothing. Topics without a namespace
    give no result.
    """
    parts = _without_transport(camera_topic)
    near = [c for c in channels if len(parts) > 1 and _parts(c.topic)[:-1] == parts[:-1] and fits(role, c)]
    said = {channel.topic: _spoken(_parts(channel.topic)[-1]) for channel in near}
    could = sorted(topic for topic, words in said.items() if words <= _own_words(role) | _spoken(parts[-1]))
    return tuple(topic for topic in could if said[topic]) or tuple(could)


def _fitting(role: Role, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics of the right schema whose names do not suggest another role."""
    return distinct(c for c in channels if fits(role, c) and _spoken(c.topic) == _own_words(role))


def _other_side(topic: str, channels: Iterable[Channel]) -> tuple[str, ...]:
    """The topic with ``right`` instead of ``left`` in its name, if it is there."""
    sides = {"left": "right", "Left": "Right", "LEFT": "RIGHT"}
    other = re.sub("|".join(sides), lambda found: sides[found[0]], topic)
    return distinct(c for c in channels if c.topic == other != topic and fits(ROLES["right"], c))


def _shared_parts(one: str, other: str) -> int:
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
