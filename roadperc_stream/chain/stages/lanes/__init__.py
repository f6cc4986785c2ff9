"""The ego lane: straight lines in the image, curves on the road, and both boundaries over time."""

from roadperc_stream.chain.stages.lanes.ego_lane import step
from roadperc_stream.chain.stages.lanes.tracking import LanesState

__all__ = ["LanesState", "step"]
