"""Disparities of an image twice as fine: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.doubling_compiled import doubled
except ImportError:
    from roadperc_stream.core.kernels.doubling_plain import doubled

__all__ = ["doubled"]
