"""How many points of the road and of obstacles lie in the cells of a grid: compiled, or by numpy."""

from roadperc_stream.core.kernels.cell_counts_plain import Cells, KnownPixels

try:
    from roadperc_stream.core.kernels.cell_counts_compiled import count_points
except ImportError:
    from roadperc_stream.core.kernels.cell_counts_plain import count_points

__all__ = ["Cells", "KnownPixels", "count_points"]
