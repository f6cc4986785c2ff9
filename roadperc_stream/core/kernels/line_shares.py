"""How much of lines lies on a mask: compiled, or by numpy and OpenCV with the same answer."""

try:
    from roadperc_stream.core.kernels.line_shares_compiled import line_shares
except ImportError:
    from roadperc_stream.core.kernels.line_shares_plain import line_shares

__all__ = ["line_shares"]
