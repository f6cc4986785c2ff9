"""The pixels of a class divided into regions where the depth jumps."""

from roadperc_stream.core.kernels.division_plain import numbered

try:
    from roadperc_stream.core.kernels.division_compiled import divided
except ImportError:
    from roadperc_stream.core.kernels.division_plain import divided

__all__ = ["divided", "numbered"]
