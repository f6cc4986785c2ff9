"""Visual odometry: points followed from a keyframe, and the motion they tell."""

from roadperc_stream.chain.stages.odometry.ego_motion import OdometryState, step

__all__ = ["OdometryState", "step"]
