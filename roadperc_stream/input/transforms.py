"""The tree of transforms: the parent of each frame, and the transform between any two frames."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from roadperc_stream.errors import ChannelError
from roadperc_stream.geometry import Camera, Float, inverse
from roadperc_stream.model import Transform


@dataclass(frozen=True)
class TransformTree:
    """A tree of frames; one edge connects each frame to its parent."""

    edges: Mapping[str, Transform] = field(default_factory=dict)
    """By child."""

    @cached_property
    def _paths(self) -> dict[str, dict[str, Float]]:
        """Cached paths to the root. This is not a field, because fields are part of an encoded state."""
        return {}

    def updated(self, edges: Iterable[Transform]) -> "TransformTree":
        """The tree with some edges added or replaced."""
        return TransformTree({**self.edges, **{edge.child: edge for edge in edges}})

    def knows(self, frame: str) -> bool:
        """Whether the tree contains a frame."""
        return frame in self.edges or any(edge.parent == frame for edge in self.edges.values())

    def lookup(self, target: str, source: str) -> Float | None:
        """target_T_source along the tree; None if the frames are not connected.

        Raises:
            ChannelError: the tree has a loop.
        """
        target_to_root, source_to_root = self._to_root(target), self._to_root(source)
        for frame, frame_T_target in target_to_root.items():
            if frame in source_to_root:
                result: Float = inverse(frame_T_target) @ source_to_root[frame]
                return result
        return None

    def _to_root(self, frame: str) -> dict[str, Float]:
        """ancestor_T_frame of a frame and all its ancestors, nearest first."""
        if frame in self._paths:
            return self._paths[frame]
        path, at = {frame: np.eye(4)}, frame
        while (edge := self.edges.get(at)) is not None:
            if edge.parent in path:
                raise ChannelError(f"/tf: frame {edge.parent!r} is its own ancestor: expected a tree of transforms")
            path[edge.parent] = edge.parent_T_child @ path[at]
            at = edge.parent
        self._paths[frame] = path
        return path

    def rooted_at(self, frame: str) -> "TransformTree":
        """The same tree with a frame as its root; the edges above it are inverted."""
        edges, at = dict(self.edges), frame
        above = edges.pop(frame, None)
        while above is not None:
            inverted = Transform(at, above.parent, inverse(above.parent_T_child))
            at, above = above.parent, edges.get(above.parent)
            edges[at] = inverted
        return TransformTree(edges)

    def fitting(self, edges: tuple[Transform, ...], most: int) -> tuple[Transform, ...]:
        """The edges without those to new frames that would give the tree more than ``most`` edges."""
        room = most - len(self.edges)
        if len(edges) <= room:
            return edges
        new = list(dict.fromkeys(edge.child for edge in edges if edge.child not in self.edges))
        beyond = set(new[max(room, 0) :])
        return tuple(edge for edge in edges if edge.child not in beyond)

    def looping(self, edges: Iterable[Transform]) -> tuple[str, ...]:
        """Children of the edges that would be part of a loop in the tree, in their order.

        Edges of the same message that contradict each other are all included. An edge that contradicts the tree is
        included alone. ``edges`` are those of one message.
        """
        edges = tuple(edges)
        parents, found = {edge.child: edge.parent for edge in edges}, set[str]()
        while loops := {child for child in parents if self._is_own_ancestor(child, parents)}:
            found |= loops
            parents = {child: parent for child, parent in parents.items() if child not in loops}
        return tuple(dict.fromkeys(edge.child for edge in edges if edge.child in found))

    def _is_own_ancestor(self, frame: str, parents: Mapping[str, str]) -> bool:
        """Whether the ancestors of a frame lead back to it; ``parents`` replace those in the tree."""
        at, passed = frame, set[str]()
        while at not in passed and (at in parents or at in self.edges):
            passed.add(at)
            at = parents[at] if at in parents else self.edges[at].parent
        return bool(passed) and at == frame


@dataclass(frozen=True)
class LatchedState:
    """The camera of each calibration role and the transform tree at one instant."""

    cameras: Mapping[str, Camera] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)

    def updated(self, role: str, content: object) -> "LatchedState":
        """The state after a calibration or transforms message."""
        if isinstance(content, Camera):
            return LatchedState({**self.cameras, role: content}, self.tree)
        edges = content if isinstance(content, tuple) else ()
        return LatchedState(self.cameras, self.tree.updated(edge for edge in edges if isinstance(edge, Transform)))


NOTHING_LATCHED: Final = LatchedState()
