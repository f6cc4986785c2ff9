"""How far disparities and depths are off: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.disparity_errors_compiled import disparity_errors
except ImportError:
    from roadperc_stream.core.kernels.disparity_errors_plain import disparity_errors

__all__ = ["disparity_errors"]
