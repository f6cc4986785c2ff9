"""Collects the contents of a log that a layout can show."""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Final

from roadperc_stream import log
from roadperc_stream.errors import DecodeError
from roadperc_stream.input.decoding import Payload, context_of_channel, decode, schemas_of_kind
from roadperc_stream.input.earlier_replay import is_result, is_result_of
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import Channel, LogSummary
from roadperc_stream.model import EGO, DepthImage, Transform
from roadperc_stream.schemas import topics
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.roles import ROLES, Kind
from roadperc_stream.view.result_frames import read_rows, require_shown

_DEPTH_ROLES: Final = ("depth", "truth_depth")
_TF_ROLES: Final = ("tf", "tf_static")
_COLUMNS: Final = frozenset(field.name for field in fields(FrameMetrics))
_IN_THE_EGO_FRAME: Final = {
    topics.DRIVABLE_SCENE_TOPIC,
    topics.LANES_SCENE_TOPIC,
    topics.OBJECTS_SCENE_TOPIC,
    topics.OCCUPANCY_TOPIC,
    topics.TF_TOPIC,
}
"""Results that name the ego frame."""


@dataclass(frozen=True)
class LogContents:
    """Topics with messages, and facts that panels need."""

    roles: Mapping[str, str]
    """Topic by role."""
    results: frozenset[str] = frozenset()
    """Topics of a replay, including pictures on request and topics of the live server."""
    columns: frozenset[str] = frozenset()
    """Metrics with a value in at least one frame."""
    depth_in_metres: frozenset[str] = frozenset()
    """Depth topics in metres instead of millimetres; viewers colour the raw numbers."""
    more_images: tuple[str, ...] = ()
    """Image topics without a role."""
    has_ego_frame: bool = False
    """Whether the log has the ego frame, which the 3D scene follows."""


OF_A_LIVE_REPLAY: Final = LogContents(
    roles={name: role.topic for name, role in ROLES.items()},
    results=frozenset(topics.RESULTS) | {topics.TIMES_TOPIC},
    columns=_COLUMNS,
    has_ego_frame=True,
)
"""The contents that a live replay serves, without pictures on request."""


def contents_of(path: log.AnyLog, overrides: Mapping[str, str]) -> LogContents:
    """Return the contents of a log.

    ``overrides`` are topics by role, from ``--topic``.

    Raises:
        RoadpercError: the log cannot be read or has nothing to show, or its channels do not fit the roles.
    """
    summary = log.summarise(path)
    roles = assignment_of_log(summary, overrides)
    require_shown(summary, roles)
    present = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    results = frozenset(channel.topic for channel in present if is_result_of(channel, channel.topic))
    return LogContents(
        roles=roles.topics,
        results=results,
        columns=_columns(summary) if topics.METRICS_TOPIC in results else frozenset(),
        depth_in_metres=frozenset(_depth_in_metres(summary, roles.topics)),
        more_images=_more_images(present, roles.topics.values()),
        has_ego_frame=bool(results & _IN_THE_EGO_FRAME) or EGO in _frames(summary, roles.topics),
    )


def _columns(summary: LogSummary) -> frozenset[str]:
    """The metrics with a value in at least one frame."""
    rows = read_rows(summary, Problems())
    return frozenset(name for _, row in rows for name in _COLUMNS if getattr(row, name) not in (None, ()))


def _more_images(channels: Iterable[Channel], known: Iterable[str]) -> tuple[str, ...]:
    """Image topics without a role that are not results."""
    schemas, filled = set(schemas_of_kind("image")), set(known)
    images = (c for c in channels if (c.schema_name, c.message_encoding) in schemas and not is_result(c))
    return tuple(sorted({channel.topic for channel in images} - filled))


def _depth_in_metres(summary: LogSummary, assigned: Mapping[str, str]) -> Iterable[str]:
    """Depth topics in metres (32FC1, no largest value), judged by the first readable message."""
    for role in _DEPTH_ROLES:
        first = _first(summary, "depth", assigned[role]) if role in assigned else None
        if isinstance(first, DepthImage) and math.isinf(first.limit_m):
            yield assigned[role]


def _frames(summary: LogSummary, assigned: Mapping[str, str]) -> set[str]:
    """The coordinate frames in the first transform messages of a log."""
    payloads = (_first(summary, "tf", assigned[role]) for role in _TF_ROLES if role in assigned)
    edges = [edge for payload in payloads if isinstance(payload, tuple) for edge in payload]
    return {name for edge in edges if isinstance(edge, Transform) for name in (edge.parent, edge.child)}


def _first(summary: LogSummary, kind: Kind, topic: str) -> Payload | None:
    """The first readable message of a topic."""
    for message in log.read(summary, topics=[topic]):
        channel, time_ns = message.channel, message.log_time_ns
        context = context_of_channel(channel, "auto")
        with suppress(DecodeError):
            return decode(kind, channel.schema_name, channel.message_encoding, message.data, time_ns, context).payload
    return None
