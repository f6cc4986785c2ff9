"""Edges towards the road: compiled, or by numpy with the same result."""

try:
    from roadperc_stream.core.kernels.facing_edges_compiled import facing_edges
except ImportError:
    from roadperc_stream.core.kernels.facing_edges_plain import facing_edges

__all__ = ["facing_edges"]
