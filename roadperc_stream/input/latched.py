"""Messages that hold until replaced: calibrations and transforms."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.core.geometry import Camera
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.stream import Stamped
from roadperc_stream.input.transforms import TransformTree

_MOST_EDGES_NAMED: Final = 3
"""Transforms that a message about them names."""


@dataclass(frozen=True)
class LatchedState:
    """The camera of each calibration role, and the transform tree, as they are at one instant."""

    cameras: Mapping[str, Camera] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)

    def updated(self, item: Stamped) -> "LatchedState":
        """The state after a calibration or transforms message."""
        if isinstance(item.payload, Camera):
            return LatchedState({**self.cameras, item.role: item.payload}, self.tree)
        return LatchedState(self.cameras, self.tree.updated(item.edges))

    def split_new(self, item: Stamped, most: int) -> tuple[Stamped, int]:
        """The item without the edges to new frames that would make the tree larger, and how many these are."""
        room = most - len(self.tree.edges)
        if len(item.edges) <= room:
            return item, 0
        new = list(dict.fromkeys(edge.child for edge in item.edges if edge.child not in self.tree.edges))
        beyond = set(new[max(room, 0) :])
        kept = tuple(edge for edge in item.edges if edge.child not in beyond)
        return (replace(item, payload=kept), len(beyond)) if beyond else (item, 0)

    def split_loops(self, item: Stamped) -> tuple[Stamped, tuple[str, ...]]:
        """The item without the edges that would be part of a loop, and these edges' children."""
        looping = self.tree.looping(item.edges) if item.edges else ()
        kept = tuple(edge for edge in item.edges if edge.child not in looping)
        return replace(item, payload=kept) if looping else item, looping


def without_loops(
    items: Iterable[Stamped],
    latched: LatchedState,
    topics: Mapping[str, str],
    problems: Problems,
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> Iterator[Stamped]:
    """The items, but for transforms that close a loop or are too many: those are left out and reported.

    Args:
        items: in the order in which they come to hold.
        latched: the state before the first of them.
        topics: of the roles.
        problems: takes the loops, and what is too many.
        limits: of the tree.
    """
    for found in items:
        item, beyond = latched.split_new(found, limits.transforms)
        if beyond:
            topic, most = topics[item.role], f"limits.transforms {limits.transforms}"
            words = f"{beyond} transforms to more frames than {most}: left out"
            problems.report(topic, f"{topic}: message at {item.log_time_ns} ns: {words}")
        kept, looping = latched.split_loops(item)
        if looping:
            topic = topics[item.role]
            problems.report(topic, f"{topic}: message at {item.log_time_ns} ns: {_loop_in_words(item, looping)}")
        if kept.edges:
            latched = latched.updated(kept)
        if kept.edges or not (looping or beyond):
            yield kept


def _loop_in_words(item: Stamped, children: Collection[str]) -> str:
    edges = [f"{edge.parent!r} to {edge.child!r}" for edge in item.edges if edge.child in children]
    some = ", ".join(edges[:_MOST_EDGES_NAMED]) + ", ..." * (len(edges) > _MOST_EDGES_NAMED)
    return f"a loop of transforms ({some}), expected a tree: left out"
