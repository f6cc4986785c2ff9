"""The pixels of a depth image that lie near a plane, and their moments: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.plane_pixels_compiled import (
        count_near,
        mark_known,
        mark_near,
        marked,
        moments_near,
    )
except ImportError:
    from roadperc_stream.core.kernels.plane_pixels_plain import count_near, mark_known, mark_near, marked, moments_near

__all__ = ["count_near", "mark_known", "mark_near", "marked", "moments_near"]
