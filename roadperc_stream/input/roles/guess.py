"""Which topic is assigned to a role that has no known topic: the only one that fits, none where it is ambiguous."""

from collections.abc import Collection, Iterable, Mapping
from typing import Final

from roadperc_stream.errors import ChannelError
from roadperc_stream.input.roles.topic_names import (
    CAMERA_OF,
    beside_camera,
    distinct,
    fits,
    fitting,
    nearest,
    shared_parts,
)
from roadperc_stream.log import Channel
from roadperc_stream.schemas.roles import ROLES, Role

_GUESSED_ROLES: Final = ("image", "calibration", "depth", "segmentation", "detections", "tf")
"""Roles that a topic of another name is assigned to, where only one fits."""
_NEEDED_ROLES: Final = ("image", "calibration")
"""Roles without which no frame can be made: where several topics fit, somebody must choose."""


def guess(role: Role, inputs: Collection[Channel], topics: Mapping[str, str]) -> str | None:
    """The topic of another name that is assigned to a role; None where there is none, or it is ambiguous.

    Points and a pair's images are not guessed, for those of a radar, or of another camera, are of the same schema.

    Raises:
        ChannelError: there are several, and the role is needed.
    """
    if CAMERA_OF.get(role.name) in topics:
        return _calibration(role, inputs, topics)
    return choice(role, fitting(role, unassigned(inputs, topics)), topics) if role.name in _GUESSED_ROLES else None


def _calibration(role: Role, inputs: Collection[Channel], topics: Mapping[str, str]) -> str | None:
    """The only calibration beside a camera's images, else the one whose name says so; never one beside another's.

    Where the only one beside both an image and its depth is the image's, the depth goes with it.

    Raises:
        ChannelError: there are several, and the role is needed.
    """
    others = {name: CAMERA_OF[name] for name in CAMERA_OF if name != role.name and CAMERA_OF[name] in topics}
    if role.name == "calibration":
        others.pop("depth_calibration", None)
    theirs = {t for name, camera in others.items() for t in beside_camera(ROLES[name], topics[camera], inputs)}
    beside = beside_camera(role, topics[CAMERA_OF[role.name]], inputs)
    elsewhere = fitting(role, (c for c in unassigned(inputs, topics) if c.topic not in theirs))
    found = choice(role, beside or elsewhere, topics)
    return None if found in theirs or found in topics.values() else found


def choice(role: Role, could: tuple[str, ...], topics: Mapping[str, str]) -> str | None:
    """The one of a role's topics, in its camera's namespace where there are several; None where that is ambiguous.

    Raises:
        ChannelError: there are several, and the role is needed.
    """
    camera_topic = topics.get(CAMERA_OF.get(role.name, "image"), "")
    near = nearest(could, camera_topic) if len(could) > 1 else could
    if len(near) > 1 and role.name in _NEEDED_ROLES:
        raise ChannelError(
            f"{len(near)} topics fit role {role.name}: {', '.join(near)}; choose one with --topic {role.name}={near[0]}"
        )
    return near[0] if len(near) == 1 else None


def could_serve(role: Role, unused: Collection[Channel], assigned: Mapping[str, str]) -> tuple[str, ...]:
    """A role's candidates by name; of a camera that is there every calibration left over, those beside it first.

    The depth's own calibration is not needed, so that another camera's is none of its candidates.
    """
    camera_topic = assigned.get(CAMERA_OF.get(role.name, ""))
    named = fitting(role, unused)
    if camera_topic is None:
        return named
    beside = beside_camera(role, camera_topic, unused)
    left_over = distinct(c for c in unused if fits(role, c)) if role.name != "depth_calibration" else ()
    found = dict.fromkeys((*beside, *(named or left_over)))
    return tuple(sorted(found, key=lambda topic: -shared_parts(topic, camera_topic)))


def unassigned(channels: Iterable[Channel], topics: Mapping[str, str]) -> list[Channel]:
    """Channels whose topics are assigned to no role."""
    return [channel for channel in channels if channel.topic not in topics.values()]
