"""Quadratics through the points beside a line: compiled where they could be."""

from roadperc_stream.core.kernels.robust_quadratic_plain import Following, Points, Quadratic, Weighing

try:
    from roadperc_stream.core.kernels.robust_quadratic_compiled import counts_aside, follow, rows_beside
except ImportError:
    from roadperc_stream.core.kernels.robust_quadratic_plain import counts_aside, follow, rows_beside

__all__ = ["Following", "Points", "Quadratic", "Weighing", "counts_aside", "follow", "rows_beside"]
