"""Depth from a stereo pair: rectified where it must be, matched, and turned back to the camera as it is mounted."""

from roadperc_stream.chain.stages.stereo.pair import match

__all__ = ["match"]
