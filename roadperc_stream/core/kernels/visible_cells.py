"""Cells of a grid on the road that an image shows to be drivable: compiled, or by numpy with the same answer."""

from roadperc_stream.core.kernels.visible_cells_plain import Middles

try:
    from roadperc_stream.core.kernels.visible_cells_compiled import mark_visible
except ImportError:
    from roadperc_stream.core.kernels.visible_cells_plain import mark_visible

__all__ = ["Middles", "mark_visible"]
