"""Messages of several sensors to frames: bounded, and it counts what it drops.

Every message of the reference role (``image``, else the first of ``REFERENCE_ROLES`` the log fills) makes one frame.
Of each other role it takes the message whose own stamp is nearest, within the tolerance. Messages come in log-time
order and may arrive late: a frame waits until every stream has passed its stamp, at most ``max_wait_s`` of log time.
"""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.core.config import SyncConfig
from roadperc_stream.core.datatypes import Transform
from roadperc_stream.core.geometry import Camera, Float, inverse
from roadperc_stream.core.time import seconds_to_ns
from roadperc_stream.errors import ChannelError
from roadperc_stream.input.decoding import Payload
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES

_MOST_WAITING = 100
"""Frames that may wait for a silent sensor where all log times are equal."""
HELD_KINDS = ("calibration", "tf")
"""Kinds whose messages hold until replaced."""


@dataclass(frozen=True, eq=False)
class Stamped:
    """One decoded message of a role."""

    role: str
    log_time_ns: int
    stamp_ns: int
    payload: Payload

    @property
    def edges(self) -> tuple[Transform, ...]:
        """The transforms of a transforms message; none of any other."""
        parts = self.payload if isinstance(self.payload, tuple) else ()
        return tuple(part for part in parts if isinstance(part, Transform))

    def children(self) -> tuple[str, ...]:
        """Frames whose place a transforms message tells; for other messages one empty name."""
        return tuple(edge.child for edge in self.edges) or ("",)


@dataclass(frozen=True)
class Held:
    """What holds until replaced: the camera of each calibration role, and the transform tree by child."""

    cameras: Mapping[str, Camera] = field(default_factory=dict)
    transforms: Mapping[str, Transform] = field(default_factory=dict)

    def updated(self, item: Stamped) -> "Held":
        """The state after a calibration or transform message."""
        if isinstance(item.payload, Camera):
            return Held({**self.cameras, item.role: item.payload}, self.transforms)
        return Held(self.cameras, {**self.transforms, **{edge.child: edge for edge in item.edges}})

    def in_loops(self, item: Stamped) -> tuple[str, ...]:
        """Children of a transforms message whose edges would be part of a loop in the tree, in its order.

        An edge that contradicts another one of the same message goes with it, for neither is more likely; one that
        contradicts the tree so far goes alone.
        """
        edges, found = {edge.child: edge.parent for edge in item.edges}, set[str]()
        known = {child: edge.parent for child, edge in self.transforms.items()}
        while loops := _in_loops({**known, **edges}, edges):
            found |= loops
            edges = {child: parent for child, parent in edges.items() if child not in loops}
        return tuple(dict.fromkeys(edge.child for edge in item.edges if edge.child in found))

    def without_loops(self, item: Stamped) -> tuple[Stamped, tuple[str, ...]]:
        """The item without the edges that would be part of a loop, and these edges' children."""
        looped = self.in_loops(item) if item.edges else ()
        kept = tuple(edge for edge in item.edges if edge.child not in looped)
        return replace(item, payload=kept) if looped else item, looped

    def lookup(self, target: str, source: str) -> Float | None:
        """target_T_source along the tree; None where the frames are not connected.

        Raises:
            ChannelError: the tree has a loop.
        """
        up_target, up_source = self._to_root(target), self._to_root(source)
        for frame, frame_T_target in up_target.items():
            if frame in up_source:
                result: Float = inverse(frame_T_target) @ up_source[frame]
                return result
        return None

    def _to_root(self, frame: str) -> dict[str, Float]:
        """ancestor_T_frame of a frame and all its ancestors, nearest first."""
        chain = {frame: np.eye(4)}
        at = frame
        while (edge := self.transforms.get(at)) is not None:
            if edge.parent in chain:
                raise ChannelError(f"/tf: frame {edge.parent!r} hangs on itself: expected a tree of transforms")
            chain[edge.parent] = edge.parent_T_child @ chain[at]
            at = edge.parent
        return chain


def _in_loops(parent_of: Mapping[str, str], starts: Iterable[str]) -> set[str]:
    """The frames from which the way up comes back to them; ``starts`` are those whose ways are followed."""
    found, done = set[str](), set[str]()
    for start in starts:
        way: dict[str, None] = {}
        at = start
        while at in parent_of and at not in done and at not in way:
            way[at] = None
            at = parent_of[at]
        done |= way.keys()
        if at in way:
            frames = list(way)
            found.update(frames[frames.index(at) :])
    return found


@dataclass(frozen=True)
class Moment:
    """The messages of one instant by role, the reference among them, and what held then."""

    reference: Stamped
    parts: Mapping[str, Stamped]
    held: Held
    skew_ns: int | None


@dataclass
class SyncCounts:
    """What became of the messages: a mutable tally that ``synchronise`` keeps."""

    frames: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    """Messages per role that belong to no frame."""


def reference_role(filled: Iterable[str]) -> str:
    """The role whose messages make the frames.

    Raises:
        ChannelError: none of them is filled.
    """
    filled = set(filled)
    for role in REFERENCE_ROLES:
        if role in filled:
            return role
    raise ChannelError(f"no channel fills any of the roles {', '.join(REFERENCE_ROLES)}: nothing to replay")


def synchronise(
    cfg: SyncConfig, items: Iterable[Stamped], reference: str, roles: Iterable[str], held: Held, counts: SyncCounts
) -> Iterator[Moment]:
    """Group messages into moments, in the order of the reference messages.

    Args:
        cfg: tolerance and longest wait.
        items: messages in log-time order.
        reference: role whose messages make the frames.
        roles: the other roles the log fills.
        held: calibrations and transforms known before the first message.
        counts: filled in.
    """
    streams = {role: deque[Stamped]() for role in roles if role != reference and ROLES[role].kind not in HELD_KINDS}
    waiting: deque[tuple[Stamped, Held]] = deque()
    for item in items:
        if ROLES[item.role].kind in HELD_KINDS:
            held = held.updated(item)
        elif item.role == reference:
            waiting.append((item, held))
        elif item.role in streams:
            streams[item.role].append(item)
        while waiting and (len(waiting) > _MOST_WAITING or _complete(cfg, waiting[0][0], streams, item.log_time_ns)):
            yield _moment(cfg, *waiting.popleft(), streams, counts)
        _forget(cfg, streams, item.log_time_ns, counts)
    while waiting:
        yield _moment(cfg, *waiting.popleft(), streams, counts)
    counts.dropped.update({role: len(stream) for role, stream in streams.items() if stream})


def _complete(cfg: SyncConfig, reference: Stamped, streams: Mapping[str, deque[Stamped]], now_ns: int) -> bool:
    """Whether nothing that could still come would fit the frame better."""
    if now_ns - reference.log_time_ns > seconds_to_ns(cfg.max_wait_s):
        return True
    return all(stream and stream[-1].stamp_ns >= reference.stamp_ns for stream in streams.values())


def _moment(
    cfg: SyncConfig, reference: Stamped, held: Held, streams: Mapping[str, deque[Stamped]], counts: SyncCounts
) -> Moment:
    tolerance_ns = seconds_to_ns(cfg.tolerance_s)
    parts = {reference.role: reference}
    for role, stream in streams.items():
        _drop_older(stream, reference.stamp_ns - tolerance_ns, role, counts)
        nearest = min(stream, key=lambda part: abs(part.stamp_ns - reference.stamp_ns), default=None)
        if nearest is not None and abs(nearest.stamp_ns - reference.stamp_ns) <= tolerance_ns:
            parts[role] = nearest
            stream.remove(nearest)
    counts.frames += 1
    skews = [abs(part.stamp_ns - reference.stamp_ns) for part in parts.values() if part is not reference]
    return Moment(reference, parts, held, max(skews, default=None))


def _forget(cfg: SyncConfig, streams: Mapping[str, deque[Stamped]], now_ns: int, counts: SyncCounts) -> None:
    """Drop what no frame can want any more, so that a log whose images stop does not fill the memory."""
    limit_ns = now_ns - seconds_to_ns(2 * cfg.max_wait_s)
    for role, stream in streams.items():
        while stream and stream[0].log_time_ns < limit_ns:
            stream.popleft()
            counts.dropped[role] += 1


def _drop_older(stream: deque[Stamped], limit_ns: int, role: str, counts: SyncCounts) -> None:
    while stream and stream[0].stamp_ns < limit_ns:
        stream.popleft()
        counts.dropped[role] += 1
