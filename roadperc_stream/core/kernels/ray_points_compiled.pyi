import numpy as np
from numpy.typing import NDArray

def points_along_rays(
    depth_m: NDArray[np.float32],
    column: NDArray[np.float32],
    row: NDArray[np.float32],
    start_m: NDArray[np.float32],
    points: NDArray[np.float32],
) -> None: ...
