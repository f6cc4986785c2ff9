"""Which pixels of a stereo pair's left image the right camera sees too."""

try:
    from roadperc_stream.core.kernels.occlusion_compiled import seen_by_both
except ImportError:
    from roadperc_stream.core.kernels.occlusion_plain import seen_by_both

__all__ = ["seen_by_both"]
