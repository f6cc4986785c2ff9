"""The pixels of a class: compiled, or by numpy with the same answer."""

try:
    from roadperc_stream.core.kernels.class_masks_compiled import mark_class
except ImportError:
    from roadperc_stream.core.kernels.class_masks_plain import mark_class

__all__ = ["mark_class"]
