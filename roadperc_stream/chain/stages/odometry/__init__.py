"""Visual odometry: features tracked from a keyframe, and the motion estimated from them."""

from roadperc_stream.chain.stages.odometry.ego_motion import step
from roadperc_stream.chain.stages.odometry.keyframes import OdometryState, counted_from_here

__all__ = ["OdometryState", "counted_from_here", "step"]
