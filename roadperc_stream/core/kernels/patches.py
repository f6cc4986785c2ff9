"""Patches of one image aligned with another one: compiled, or by numpy with the same bits."""

try:
    from roadperc_stream.core.kernels.patches_compiled import align_patches
except ImportError:
    from roadperc_stream.core.kernels.patches_plain import align_patches

__all__ = ["align_patches"]
