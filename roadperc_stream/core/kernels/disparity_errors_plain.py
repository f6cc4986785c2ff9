"""What ``disparity_errors_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


def disparity_errors(
    estimated_m: Float32,
    true_m: Float32,
    seen: NDArray[np.bool_],
    scale_px_m: float,
    max_depth_m: float,
    bad_px: float,
    bad_share: float,
) -> tuple[Float32, Float32, int, int]:
    """How far an estimated depth is off over the pixels that count, those seen whose true depth is below the largest.

    All in float32.

    Args:
        estimated_m: (H, W); where its disparity is not finite nothing is known.
        true_m: (H, W).
        seen: (H, W) pixels.
        scale_px_m: a disparity is this over its depth.
        max_depth_m: the largest.
        bad_px: a disparity farther off is bad,
        bad_share: if it is farther off than this share of the true one, too.

    Returns:
        (N,) absolute errors of the disparity and (N,) relative ones of the depth where it is known, row by row, and the
        numbers of pixels that count and whose disparity is bad.

    Raises:
        ValueError: other sizes.
    """
    if not estimated_m.shape == true_m.shape == seen.shape:
        raise ValueError(f"{estimated_m.shape}, {true_m.shape}, {seen.shape}: expected one size")
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        estimated_px, true_px = (np.float32(scale_px_m) / depth_m for depth_m in (estimated_m, true_m))
        counted = seen & (true_m < np.float32(max_depth_m))
        known = counted & np.isfinite(estimated_px)
        error_px = np.abs(estimated_px - true_px)
        bad = known & (error_px > np.float32(bad_px)) & (error_px > np.float32(bad_share) * true_px)
        relative = np.abs(estimated_m - true_m) / true_m
    return error_px[known], relative[known], int(np.count_nonzero(counted)), int(np.count_nonzero(bad))
