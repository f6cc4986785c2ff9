"""Visual odometry: features tracked from a keyframe, and the motion estimated from them."""

from roadperc_stream.chain.stages.odometry.ego_motion import OdometryState, step

__all__ = ["OdometryState", "step"]
