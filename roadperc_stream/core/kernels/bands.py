"""Normal equations in which only neighbouring unknowns stand together."""

try:
    from roadperc_stream.core.kernels.bands_compiled import normal_equations
except ImportError:
    from roadperc_stream.core.kernels.bands_plain import normal_equations

__all__ = ["normal_equations"]
