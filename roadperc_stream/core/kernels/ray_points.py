"""Points of depth pixels in a turned and moved frame: compiled, or by numpy with the same bits."""

from roadperc_stream.core.kernels.ray_points_plain import Rays

try:
    from roadperc_stream.core.kernels.ray_points_compiled import points_along_rays
except ImportError:
    from roadperc_stream.core.kernels.ray_points_plain import points_along_rays

__all__ = ["Rays", "points_along_rays"]
