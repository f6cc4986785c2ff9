"""The pixels of a depth image that lie near a plane, and their moments: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.plane_pixels_compiled import mark_near, marked, moments_near
except ImportError:
    from roadperc_stream.core.kernels.plane_pixels_plain import mark_near, marked, moments_near

__all__ = ["mark_near", "marked", "moments_near"]
