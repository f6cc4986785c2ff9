"""Disparities moved to where the two images fit best: compiled, or by numpy and OpenCV with the same bits."""

try:
    from roadperc_stream.core.kernels.refinement_compiled import refined_disparities
except ImportError:
    from roadperc_stream.core.kernels.refinement_plain import refined_disparities

__all__ = ["refined_disparities"]
