import numpy as np
from numpy.typing import NDArray

def align_patches(
    before: NDArray[np.uint8],
    before_px: NDArray[np.float64],
    stretch: NDArray[np.float64],
    after: NDArray[np.uint8],
    px: NDArray[np.float64],
    correlation: NDArray[np.float64],
    iterations: int,
) -> None: ...
