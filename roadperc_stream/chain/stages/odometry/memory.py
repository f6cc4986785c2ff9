"""What the odometry remembers from one frame to the next."""

from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe
from roadperc_stream.core.datatypes import read_only
from roadperc_stream.core.geometry import Float, Float32, inverse


@dataclass(frozen=True)
class LastFrame:
    """The last frame whose pose is known, or at which the odometry began anew.

    ``velocity`` is (6,) metres and radians per second in the ego frame, None before there are two frames. ``found_px``
    is (N, 2), where the keyframe's features were found last. ``influence`` is (N, 6), how far each of them
    pulls the pose against the keyframe, in ego's axes, None where that is not known; ``length_variance`` is that of the
    distance from the keyframe, in square metres, beyond what they show. ``speed_variance`` is in square metres per
    second squared, None where the road has shown no speed.
    """

    stamp_ns: int
    velocity: Float | None
    found_px: Float32
    influence: Float | None
    length_variance: float = 0.0
    speed_variance: float | None = None

    def __post_init__(self) -> None:
        read_only(self.found_px, np.float32, (None, 2), "found_px")
        for name, array, shape in (("velocity", self.velocity, (6,)), ("influence", self.influence, (None, 6))):
            if array is not None:
                read_only(array, np.float64, shape, name)


@dataclass(frozen=True)
class OdometryState:
    """What the odometry remembers from one frame to the next."""

    odom_T_ego: Float = field(default_factory=lambda: np.eye(4))
    keyframe: Keyframe | None = None
    last: LastFrame | None = None
    pitch: CameraPitch | None = None


def counted_from_here(state: OdometryState) -> OdometryState:
    """The state with odom where ego is now."""
    if state.keyframe is None:
        return replace(state, odom_T_ego=np.eye(4))
    here_T_camera = inverse(state.odom_T_ego) @ state.keyframe.odom_T_camera
    return replace(state, odom_T_ego=np.eye(4), keyframe=replace(state.keyframe, odom_T_camera=here_T_camera))
