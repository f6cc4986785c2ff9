"""Distances of a region's pixels, smoothed: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.region_distances_compiled import region_distances
except ImportError:
    from roadperc_stream.core.kernels.region_distances_plain import region_distances

__all__ = ["region_distances"]
