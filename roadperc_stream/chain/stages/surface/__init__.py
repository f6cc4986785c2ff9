"""The drivable surface: a plane through the road's points, a height field beside it, and the pixels that lie on it."""

from roadperc_stream.chain.stages.surface.road import assumed_surface, drivable_mask, find_surface

__all__ = ["assumed_surface", "drivable_mask", "find_surface"]
