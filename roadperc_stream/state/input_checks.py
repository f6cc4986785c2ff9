"""Whether what a state says of the input is what some input can have left."""

from collections.abc import Iterable, Iterator
from typing import Final

from roadperc_stream.core.config import LimitsConfig
from roadperc_stream.core.datatypes import Transform
from roadperc_stream.core.geometry import Camera, pinhole_fault
from roadperc_stream.core.semantics import TABLES
from roadperc_stream.core.time import END_OF_TIME_NS
from roadperc_stream.input.latched import LatchedState
from roadperc_stream.input.state import FrameNumbers, InputState, PendingMessage
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.schemas.roles import LATCHED_KINDS, REFERENCE_ROLES, ROLES
from roadperc_stream.state.memory_checks import require_transform

END_OF_FRAMES: Final = 2**32
"""The first number that a log has no place for."""
END_OF_LOG_TIMES_NS: Final = 2**64
_PARENTS_PER_TRANSFORM: Final = 50
"""Frames that were left out of the full tree have parents too, which only their names are asked for."""
_MOST_IN_ROW: Final = 2
"""Reference messages that lie back: the third one begins a segment."""


def require_input(state: InputState, limits: LimitsConfig) -> None:
    """Check what an input left.

    Raises:
        ValueError: none can have left it.
    """
    _require_roles(state)
    _require_numbers(state.from_ns, state.numbers)
    _require_order(state)
    for item in state.pairing.items:
        _require_item(item, limits)
    _require_places(state.pairing.items)
    for latched in _latched(state):
        for camera in latched.cameras.values():
            _require_camera(camera, limits)
    for tree in _trees(state):
        _require_tree(tree, limits)
    most = _PARENTS_PER_TRANSFORM * limits.transforms
    if len(state.parent_of) > most:
        raise ValueError(f"parents of {len(state.parent_of)} frames: expected {most} at most, by limits.transforms")


def _require_roles(state: InputState) -> None:
    known = (*state.topics, *state.pairing.sync.streams, *(item.role for item in state.pairing.items))
    known += tuple(role for latched in _latched(state) for role in latched.cameras)
    unknown = dict.fromkeys(role for role in known if role not in ROLES)
    if unknown or state.reference not in REFERENCE_ROLES or state.reference not in state.topics:
        raise ValueError(f"roles {', '.join(unknown) or repr(state.reference)}")
    streams = state.pairing.sync.streams.items()
    misplaced = [item.role for role, items in streams for item in items if item.role != role]
    misplaced += [item.role for item, _ in state.pairing.sync.waiting if item.role != state.reference]
    if misplaced:
        raise ValueError(f"a message of role {misplaced[0]} where another role's are")
    if state.tag_table and state.tag_table not in TABLES:
        raise ValueError(f"tag table {state.tag_table!r}: expected one of {', '.join(TABLES)}")


def _require_numbers(from_ns: int, numbers: FrameNumbers) -> None:
    if not all(0 <= time_ns < END_OF_TIME_NS for time_ns in (from_ns, numbers.log_time_ns)):
        raise ValueError("a time out of its range")
    if not 0 <= numbers.next < END_OF_FRAMES:
        raise ValueError(f"frame {numbers.next}")


def _require_order(state: InputState) -> None:
    order, sync = state.pairing.order, state.pairing.sync
    segments = (sync.segment, order.given_segment, *(item.segment for item in state.pairing.items))
    if not 0 <= order.segment < END_OF_FRAMES or any(not 0 <= number <= order.segment for number in segments):
        raise ValueError("a segment out of its range")
    stamps = (ns for ns in (order.latest_ns, order.given_ns) if ns is not None)
    if any(not 0 <= ns < END_OF_TIME_NS for ns in stamps):
        raise ValueError("a time out of its range")
    row = order.row
    if len(row) > _MOST_IN_ROW or any(not 0 <= k < len(order.held) for k in row):
        raise ValueError("places of messages that are not held")


def _require_item(item: PendingMessage, limits: LimitsConfig) -> None:
    if not (0 <= item.stamp_ns < END_OF_TIME_NS and 0 <= item.log_time_ns < END_OF_LOG_TIMES_NS):
        raise ValueError("a time out of its range")
    kind = ROLES[item.role].kind
    if (item.camera is not None) != (kind == "calibration") or (item.edges is not None) != (kind == "tf"):
        raise ValueError(f"a message of role {item.role} with what another role's have")
    if item.camera is not None:
        _require_camera(item.camera, limits)
    edges = item.edges or ()
    if len(edges) > limits.transforms:
        most = f"expected limits.transforms {limits.transforms} at most"
        raise ValueError(f"a message of {len(edges)} transforms: {most}")
    _require_edges(edges, limits)


def _require_places(items: Iterable[PendingMessage]) -> None:
    """Check that no message is there twice in one role: each is decoded."""
    waiting = [item for item in items if ROLES[item.role].kind not in LATCHED_KINDS]
    places = {(item.role, item.place, None if item.place.carried else item.log_time_ns) for item in waiting}
    if len(places) < len(waiting):
        raise ValueError("a message that waits twice")


def _require_camera(camera: Camera, limits: LimitsConfig) -> None:
    if not (camera.width > 0 and camera.height > 0 and camera.width * camera.height <= limits.image_pixels):
        megapixels = f"expected limits.image_megapixels {limits.image_megapixels:g} at most"
        raise ValueError(f"camera {camera.frame_id!r} of {camera.width} x {camera.height} pixels: {megapixels}")
    if fault := pinhole_fault(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy):
        raise ValueError(f"camera {camera.frame_id!r}: {fault}")


def _require_tree(tree: TransformTree, limits: LimitsConfig) -> None:
    edges = tree.edges
    if len(edges) > limits.transforms:
        raise ValueError(f"a tree of {len(edges)} transforms: expected limits.transforms {limits.transforms} at most")
    _require_edges(edges.values(), limits)
    if any(child != edge.child for child, edge in edges.items()) or TransformTree().looping(edges.values()):
        raise ValueError("transforms that are no tree")


def _require_edges(edges: Iterable[Transform], limits: LimitsConfig) -> None:
    for edge in edges:
        require_transform(edge.parent_T_child)
        if max(len(edge.parent), len(edge.child)) > limits.name_length:
            raise ValueError(f"a frame's name: expected limits.name_length {limits.name_length} at most")


def _latched(state: InputState) -> Iterator[LatchedState]:
    yield state.pairing.sync.latched
    yield from (latched for _, latched in state.pairing.sync.waiting)


def _trees(state: InputState) -> Iterator[TransformTree]:
    yield state.arrived
    yield from (latched.tree for latched in _latched(state))
