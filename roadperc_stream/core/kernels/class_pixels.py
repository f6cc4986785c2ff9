"""The pixels of a class: compiled, or by numpy and OpenCV with the same result."""

try:
    from roadperc_stream.core.kernels.class_pixels_compiled import count_of_class, mark, mark_together
except ImportError:
    from roadperc_stream.core.kernels.class_pixels_plain import count_of_class, mark, mark_together

__all__ = ["count_of_class", "mark", "mark_together"]
