"""The drivable surface: a plane through the road's points, a height field beside it, and the pixels that lie on it."""

from roadperc_stream.chain.stages.surface.road import (
    SurfaceState,
    drivable_mask,
    estimated_surface,
    find_surface,
    remember,
)

__all__ = ["SurfaceState", "drivable_mask", "estimated_surface", "find_surface", "remember"]
