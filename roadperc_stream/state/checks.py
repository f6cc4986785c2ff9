"""What the types of a state do not say: lengths that belong together, numbers that are numbers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.odometry.ego_motion import OdometryState
from roadperc_stream.core.datatypes.arrays import read_only
from roadperc_stream.core.time import END_OF_TIME_NS
from roadperc_stream.errors import StateError
from roadperc_stream.output.writing import TRAJECTORY_POSES
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES
from roadperc_stream.state.replay_state import ReplayState


def require_sense(state: ReplayState) -> ReplayState:
    """A state as some replay can have left it.

    Raises:
        StateError: none can have.
    """
    try:
        _require_input(state)
        _require_odometry(state.memory.chain.odometry)
        for track in state.memory.chain.objects.tracks:
            if track.template is not None:
                _require_image(track.template.grey)
    except (ValueError, TypeError) as error:
        raise StateError(f"damaged: {error}") from error
    return state


def _require_input(state: ReplayState) -> None:
    known, numbers = state.input, state.input.numbers
    unknown = [role for role in (*known.topics, *(item.role for item in known.pairing.items)) if role not in ROLES]
    if unknown or known.reference not in REFERENCE_ROLES or known.reference not in known.topics:
        raise ValueError(f"roles {', '.join(unknown) or known.reference!r}")
    if len(state.memory.shown.trajectory) > TRAJECTORY_POSES:
        raise ValueError(f"trajectory of {len(state.memory.shown.trajectory)} poses")
    if not all(0 <= value < END_OF_TIME_NS for value in (known.from_ns, numbers.next, numbers.log_time_ns)):
        raise ValueError("a number out of its range")
    if any(not 0 <= k < len(known.pairing.order.held) for k in known.pairing.order.row):
        raise ValueError("places of messages that are not held")
    for item in known.pairing.items:
        for edge in item.edges or ():
            _require_transform(edge.parent_T_child)


def _require_odometry(odometry: OdometryState) -> None:
    _require_transform(odometry.odom_T_ego)
    keyframe, last = odometry.keyframe, odometry.last
    if keyframe is None or last is None:
        return
    _require_transform(keyframe.odom_T_camera)
    _require_image(keyframe.grey)
    landmarks = keyframe.landmarks
    features = landmarks.features
    parts = (features.px, features.descriptors, landmarks.points_m, landmarks.slope, last.found_px)
    if len({len(part) for part in parts}) > 1:
        raise ValueError(f"landmarks of {', '.join(str(len(part)) for part in parts)} points")


def _require_transform(matrix: NDArray[Any]) -> None:
    read_only(matrix, np.float64, (4, 4), "transform")
    if not np.isfinite(matrix).all():
        raise ValueError("a transform that is not finite")


def _require_image(grey: NDArray[Any]) -> None:
    read_only(grey, np.uint8, (None, None), "grey image")
    if not grey.size:
        raise ValueError("an empty image")
