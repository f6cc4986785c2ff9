import numpy as np
from numpy.typing import NDArray

def disparity_errors(
    estimated_m: NDArray[np.float32],
    true_m: NDArray[np.float32],
    seen: NDArray[np.bool_],
    scale_px_m: float,
    max_depth_m: float,
    bad_px: float,
    bad_share: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], int, int]: ...
