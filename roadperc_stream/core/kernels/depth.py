"""Metres of a depth camera's millimetres and back: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.depth_compiled import metres_of_mm, mm_of_metres
except ImportError:
    from roadperc_stream.core.kernels.depth_plain import metres_of_mm, mm_of_metres

__all__ = ["metres_of_mm", "mm_of_metres"]
