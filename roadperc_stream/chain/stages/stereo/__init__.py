"""Depth from a stereo pair: rectified where it must be, matched, and turned back to the camera as it is mounted."""

from roadperc_stream.chain.stages.stereo.matching import disparity
from roadperc_stream.chain.stages.stereo.pair import depth_of, disparities_needed, match

__all__ = ["depth_of", "disparities_needed", "disparity", "match"]
