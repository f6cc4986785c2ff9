import numpy as np
from numpy.typing import NDArray

def seen_by_both(disparity_px: NDArray[np.float32], occlusion_px: float) -> NDArray[np.bool_]: ...
