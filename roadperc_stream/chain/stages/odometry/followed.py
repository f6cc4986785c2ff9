"""A frame that follows others, and the motion estimated for it."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.odometry import camera_pitch
from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch
from roadperc_stream.chain.stages.odometry.depth_scale import DepthScale
from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe, LastFrame
from roadperc_stream.chain.stages.odometry.motion import Motion, moved
from roadperc_stream.chain.stages.odometry.speed import KnownSpeed
from roadperc_stream.config import OdometryConfig
from roadperc_stream.geometry import Float, Float32, inverse, rigid
from roadperc_stream.geometry.rotations import rotation_from_vector, rotation_vector
from roadperc_stream.system.time import NS_PER_S

MIN_INLIER_RATIO: Final = 0.25
"""Minimum share of the found points that agree on a steady motion without depth; twice that for an unexpected one."""


@dataclass(frozen=True)
class FollowedFrame:
    """A frame with its references: the keyframe, and the pose and pitch at the last frame."""

    cfg: OdometryConfig
    frame: TrackingFrame
    keyframe: Keyframe
    last: LastFrame
    odom_T_last: Float
    pitch: CameraPitch
    speed: KnownSpeed | None = None
    depth_scale: DepthScale = field(default_factory=DepthScale)

    @property
    def middle_ns(self) -> int:
        """The middle of the time since the last frame, at which the car has its mean speed."""
        return (self.last.stamp_ns + self.frame.stamp_ns) // 2

    @property
    def seconds(self) -> float:
        """Since the last frame."""
        return (self.frame.stamp_ns - self.last.stamp_ns) / NS_PER_S

    def pose(self, motion: Motion) -> Float:
        """odom_T_ego after a motion from the keyframe."""
        return self.keyframe.odom_T_camera @ inverse(motion.this_T_key) @ inverse(self.frame.ego_T_camera)

    def velocity(self, odom_T_ego: Float) -> Float:
        """(6,) metres and radians per second since the last frame."""
        last_T_this = inverse(self.odom_T_last) @ odom_T_ego
        return np.concatenate((last_T_this[:3, 3], rotation_vector(last_T_this[:3, :3]))) / self.seconds

    @property
    def expected_this_T_key(self) -> Float | None:
        """(4, 4) motion since the keyframe if the last motion continues; None without a last one."""
        if self.last.velocity is None:
            return None
        odom_T_camera = self.odom_T_last @ moved(self.last.velocity * self.seconds) @ self.frame.ego_T_camera
        this_T_key = inverse(odom_T_camera) @ self.keyframe.odom_T_camera
        # A motion that begins here would double the rounding error of both poses in every frame.
        return rigid(rotation_from_vector(rotation_vector(this_T_key[:3, :3])), this_T_key[:3, 3])

    @property
    def metric_speed(self) -> KnownSpeed | None:
        """The last known speed in metres per second."""
        return self.speed if self.speed is not None and self.speed.metric else None

    def limits_mps(self, variance: float = 0.0) -> tuple[float, float]:
        """Least and greatest speed of a car since the last frame; ``variance`` is that of the speed to compare."""
        if (speed := self.metric_speed) is None:
            return 0.0, self.cfg.max_speed_mps
        least, most = speed.limits_mps((self.middle_ns - speed.stamp_ns) / NS_PER_S, variance)
        return least, min(most, self.cfg.max_speed_mps)

    def turned_pitch(self, odom_T_ego: Float) -> CameraPitch:
        """The pitch, turned with the camera since the last frame."""
        return camera_pitch.predicted(self.cfg, self.pitch, inverse(self.odom_T_last) @ odom_T_ego, self.seconds)


@dataclass(frozen=True)
class Estimate:
    """The (N, 2) pixels of the keyframe's features in a frame, and the motion, pose and pitch estimated from them.

    ``findable`` is the number of features that the motion predicts in the image if all points are known, else of those
    found. ``by_orb`` is true if optical flow failed and ORB features were matched.
    """

    px: Float32
    motion: Motion
    odom_T_ego: Float
    pitch: CameraPitch
    findable: int
    by_orb: bool = False
