"""Metres of a depth camera's millimetres and back: compiled, or by numpy with the same bits."""

from roadperc_stream.core.kernels.depth_plain import DEPTH_LIMIT_MM, UNKNOWN_MM

try:
    from roadperc_stream.core.kernels.depth_compiled import metres_of_mm, mm_of_metres
except ImportError:
    from roadperc_stream.core.kernels.depth_plain import metres_of_mm, mm_of_metres

__all__ = ["DEPTH_LIMIT_MM", "UNKNOWN_MM", "metres_of_mm", "mm_of_metres"]
