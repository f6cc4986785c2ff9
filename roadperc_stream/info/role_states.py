"""Assigns channels to the roles of a replay, and describes the effect of each missing role."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from roadperc_stream.errors import ChannelError
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.roles import (
    NOTHING_TO_REPLAY,
    RoleFilling,
    SeveralTopicsError,
    assign_roles,
    candidates,
    channel_state,
)
from roadperc_stream.input.stream import RoleAssignment
from roadperc_stream.input.topics import distinct, fits
from roadperc_stream.log import Channel
from roadperc_stream.schemas.roles import ROLES, Role

_CALIBRATIONS: Final = {"left": "left_calibration", "depth": "depth_calibration"}
"""The calibration that frames of these roles can do with."""
_STEREO: Final = {"right", "right_calibration"}
_UNNAMED_TRUTH: Final = "no truth for steps and turns; a pose topic counts as truth only if you pass it"
_GIVEN: Final = "the given calibration is used"
_MOUNTED: Final = "the given mounting is used"


@dataclass(frozen=True)
class RoleState:
    """A role with its channel, or why it has no channel."""

    role: str
    state: RoleFilling
    topic: str | None = None
    """The assigned topic, or the one whose channel does not fit."""
    why: str = ""
    """The source of the topic (``contract``, ``known``, ``guessed``, ``--topic``), or its fault."""
    candidates: tuple[str, ...] = ()
    """Topics that fit, for ``--topic``."""
    cost: str = ""
    """What a replay lacks without the role."""


@dataclass(frozen=True)
class Roles:
    """All roles of a log."""

    states: tuple[RoleState, ...]
    assignment: RoleAssignment
    refusal: str | None = None
    """Why a replay with these topics stops before its first frame."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Topics by role with which it does not stop."""


def roles_of(channels: Sequence[Channel], overrides: Mapping[str, str]) -> Roles:
    """The state of every role.

    ``overrides`` are topics by role, from ``--topic``.
    """
    inputs = [channel for channel in channels if not is_result(channel)]
    refusal, options = None, dict[str, str]()
    try:
        assignment = assign_roles(inputs, overrides)
    except ChannelError as error:
        refusal, assignment = str(error), RoleAssignment(_named(inputs, overrides))
        options = dict(error.options) if isinstance(error, SeveralTopicsError) else {}
    if refusal is None and assignment.reference is None:
        refusal = NOTHING_TO_REPLAY
    unassigned = (channel for channel in inputs if channel.topic not in assignment.topics.values())
    poses = distinct(channel for channel in unassigned if fits(ROLES["truth_pose"], channel))
    could = {**candidates(inputs, assignment.topics), "truth_pose": poses}
    states = (_state(role, inputs, assignment, overrides, could.get(role.name, ())) for role in ROLES.values())
    return Roles(tuple(states), assignment, refusal, options)


def _named(inputs: Sequence[Channel], overrides: Mapping[str, str]) -> dict[str, str]:
    """The roles whose own topic exists and fits, for a log that cannot be replayed."""
    topics = {role.name: overrides.get(role.name, role.topic) for role in ROLES.values()}
    return {
        name: topic
        for name, topic in topics.items()
        if channel_state(ROLES[name], _on(topic, inputs)) == ("filled", "")
    }


def _on(topic: str, channels: Sequence[Channel]) -> list[Channel]:
    return [channel for channel in channels if channel.topic == topic]


def _state(
    role: Role,
    inputs: Sequence[Channel],
    assignment: RoleAssignment,
    overrides: Mapping[str, str],
    could: tuple[str, ...],
) -> RoleState:
    topic = assignment.topics.get(role.name)
    if topic is not None:
        return RoleState(role.name, "filled", topic, _choice(role, topic, assignment, overrides))
    named = overrides.get(role.name, role.topic)
    state, fault = channel_state(role, _on(named, inputs))
    if role.name in overrides and state == "missing":
        fault = "no such topic"
    cost = _UNNAMED_TRUTH if role.truth and could else _cost(role.name, assignment)
    if state == "filled":  # the topic fits, but the roles of this log could not be assigned
        state = "missing"
    return RoleState(role.name, state, named if fault else None, fault, could, cost)


def _choice(role: Role, topic: str, assignment: RoleAssignment, overrides: Mapping[str, str]) -> str:
    if role.name in overrides:
        return "--topic"
    if topic == role.topic:
        return "contract"
    return "guessed" if role.name in assignment.guessed else "known"


def with_given(states: Sequence[RoleState], cameras: Collection[str], *, mounted: bool) -> tuple[RoleState, ...]:
    """The states if the user gives calibrations of these roles, and a mounting: a replay lacks nothing without them."""
    given = dict.fromkeys(cameras, _GIVEN) | ({"tf": _MOUNTED} if mounted else {})
    return tuple(
        replace(state, cost=given[state.role]) if state.cost and state.role in given else state for state in states
    )


def _cost(role: str, assignment: RoleAssignment) -> str:
    """What a replay lacks without the role, given the other roles; empty for nothing."""
    there: Collection[str] = assignment.topics
    stops = "a replay stops, unless another file of the log has it"
    if role == "depth":
        return _depth_cost(there)
    needed, cost = {
        "image": ("left" not in there, "no images: no odometry"),
        "calibration": (
            _CALIBRATIONS.get(assignment.reference or "") not in there,
            f"{stops}: the camera is unknown; pass --fov or --calibration",
        ),
        "left_calibration": ("left" in there, f"{stops}: left camera unknown"),
        "right_calibration": ("right" in there, "no stereo: the baseline is unknown"),
        "segmentation": (True, "no lanes, no verified detections, the lower image counts as road"),
        "detections": (True, "no objects"),
        "tf": (
            "tf_static" not in there,
            "the camera is assumed level at the height of the setting surface.assumed_height_m",
        ),
    }.get(role, (False, ""))
    return cost if needed else ""


def _depth_cost(there: Collection[str]) -> str:
    if set(there) >= _STEREO:
        return "surface, distances and occupancy from stereo"
    if "lidar" in there:
        return "surface, distances and occupancy from the sparse lidar points"
    return (
        "surface from the mounting, distances from the boxes' lower edges, no occupancy, scale from the camera height"
    )
