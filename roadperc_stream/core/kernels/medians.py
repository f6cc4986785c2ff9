"""The place of each cell's median: compiled, or by numpy with the same answer."""

try:
    from roadperc_stream.core.kernels.medians_compiled import median_places
except ImportError:
    from roadperc_stream.core.kernels.medians_plain import median_places

__all__ = ["median_places"]
