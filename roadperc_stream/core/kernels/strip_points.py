"""Points of a strip of road and their cells: compiled, or by numpy with the same bits."""

from roadperc_stream.core.kernels.strip_points_plain import Strip

try:
    from roadperc_stream.core.kernels.strip_points_compiled import points_on_strip
except ImportError:
    from roadperc_stream.core.kernels.strip_points_plain import points_on_strip

__all__ = ["Strip", "points_on_strip"]
