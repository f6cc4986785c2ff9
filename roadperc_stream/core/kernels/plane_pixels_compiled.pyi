import numpy as np
from numpy.typing import NDArray

def mark_near(
    depth_m: NDArray[np.float32],
    column: NDArray[np.float32],
    row: NDArray[np.float32],
    offset_m: float,
    within_m: float,
    near: NDArray[np.uint8],
) -> int: ...
def moments_near(
    depth_m: NDArray[np.float32],
    column: NDArray[np.float32],
    row: NDArray[np.float32],
    offset_m: float,
    within_m: float,
    among: NDArray[np.uint8],
    ray_x: NDArray[np.float32],
) -> NDArray[np.float64]: ...
def marked(marks: NDArray[np.uint8], ranks: NDArray[np.int64]) -> NDArray[np.int64]: ...
