"""What the types of a state do not say: lengths that belong together, numbers that are numbers, cameras that see."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.odometry.ego_motion import OdometryState
from roadperc_stream.core.datatypes import Image, Transform
from roadperc_stream.core.datatypes.arrays import read_only
from roadperc_stream.core.geometry import Camera, Float, pinhole_fault
from roadperc_stream.core.time import END_OF_TIME_NS
from roadperc_stream.errors import StateError
from roadperc_stream.input.state import InputState
from roadperc_stream.output.writing import TRAJECTORY_POSES, Shown
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES
from roadperc_stream.state.replay_state import ReplayState

_END_OF_FRAMES: Final = 2**32
"""The first number that a log has no place for."""
_ROUNDING: Final = 1e-6


def require_sense(state: ReplayState) -> ReplayState:
    """A state as some replay can have left it.

    Raises:
        StateError: none can have.
    """
    memory = state.memory
    try:
        _require_input(state.input)
        _require_odometry(memory.chain.odometry)
        _require_shown(memory.shown)
        _require_finite((memory.chain.lanes, memory.chain.objects))
        for track in memory.chain.objects.tracks:
            if track.template is not None:
                _require_image(track.template.grey)
        if memory.earlier is not None and memory.earlier.odom_T_ego is not None:
            _require_transform(memory.earlier.odom_T_ego)
    except (ValueError, TypeError) as error:
        raise StateError(f"damaged: {error}") from error
    return state


def _require_input(state: InputState) -> None:
    numbers, order = state.numbers, state.pairing.order
    roles = (*state.topics, *(item.role for item in state.pairing.items))
    unknown = [role for role in roles if role not in ROLES]
    if unknown or state.reference not in REFERENCE_ROLES or state.reference not in state.topics:
        raise ValueError(f"roles {', '.join(unknown) or repr(state.reference)}")
    if not all(0 <= time_ns < END_OF_TIME_NS for time_ns in (state.from_ns, numbers.log_time_ns)):
        raise ValueError("a time out of its range")
    if not 0 <= numbers.next < _END_OF_FRAMES:
        raise ValueError(f"frame {numbers.next}")
    if any(not 0 <= k < len(order.held) for k in order.row):
        raise ValueError("places of messages that are not held")
    for camera in _cameras(state):
        if fault := pinhole_fault(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy):
            raise ValueError(f"camera {camera.frame_id!r}: {fault}")
    for edge in _edges(state):
        _require_transform(edge.parent_T_child)


def _cameras(state: InputState) -> Iterator[Camera]:
    for latched in (state.pairing.sync.latched, *(known for _, known in state.pairing.sync.waiting)):
        yield from latched.cameras.values()
    yield from (item.camera for item in state.pairing.items if item.camera is not None)


def _edges(state: InputState) -> Iterator[Transform]:
    trees = (state.pairing.sync.latched.tree, *(known.tree for _, known in state.pairing.sync.waiting))
    for tree in (state.arrived, *trees):
        yield from tree.edges.values()
    for item in state.pairing.items:
        yield from item.edges or ()


def _require_shown(shown: Shown) -> None:
    if len(shown.trajectory) > TRAJECTORY_POSES:
        raise ValueError(f"trajectory of {len(shown.trajectory)} poses")
    for odom_T_ego in shown.trajectory:
        _require_transform(odom_T_ego)


def _require_odometry(odometry: OdometryState) -> None:
    _require_transform(odometry.odom_T_ego)
    keyframe, last = odometry.keyframe, odometry.last
    if keyframe is None or last is None:
        return
    _require_transform(keyframe.odom_T_camera)
    _require_image(keyframe.grey)
    _require_finite((keyframe.camera, last.velocity, last.covariance))
    landmarks = keyframe.landmarks
    features = landmarks.features
    parts = (features.px, features.descriptors, landmarks.points_m, landmarks.slope, last.found_px)
    if len({len(part) for part in parts}) > 1:
        raise ValueError(f"landmarks of {', '.join(str(len(part)) for part in parts)} points")


def _require_finite(value: Any) -> None:
    """Check all numbers below a value."""
    if is_dataclass(value):
        for field in fields(value):
            _require_finite(getattr(value, field.name))
    elif isinstance(value, tuple):
        for item in value:
            _require_finite(item)
    elif isinstance(value, float | np.ndarray) and not np.isfinite(value).all():
        raise ValueError("a number that is not finite")


def _require_transform(matrix: Float) -> None:
    read_only(matrix, np.float64, (4, 4), "transform")
    rotation: NDArray[np.float64] = matrix[:3, :3]
    is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROUNDING) and np.linalg.det(rotation) > 0
    if not (np.isfinite(matrix).all() and is_rotation):
        raise ValueError("a transform that is none")


def _require_image(grey: Image) -> None:
    read_only(grey, np.uint8, (None, None), "grey image")
    if not grey.size:
        raise ValueError("an empty image")
