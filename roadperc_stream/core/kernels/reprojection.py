"""How far points project from where they were found, and how that changes: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.reprojection_compiled import linearise
except ImportError:
    from roadperc_stream.core.kernels.reprojection_plain import linearise

__all__ = ["linearise"]
