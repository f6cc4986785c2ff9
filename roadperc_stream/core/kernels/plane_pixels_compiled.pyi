import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]

def mark_known(depth_m: Float32, limit_m: float, among: Marks, known: Marks) -> None: ...
def mark_near(
    depth_m: Float32,
    column: Float32,
    row: Float32,
    offset_m: float,
    within_m: float,
    among: Marks,
    near: Marks,
) -> None: ...
def count_near(
    depth_m: Float32,
    column: Float32,
    row: Float32,
    offset_m: float,
    within_m: float,
    among: Marks,
) -> int: ...
def moments_near(
    depth_m: Float32,
    column: Float32,
    row: Float32,
    offset_m: float,
    within_m: float,
    among: Marks,
    ray_x: Float32,
) -> NDArray[np.float64]: ...
def marked(marks: Marks, ranks: NDArray[np.int64]) -> NDArray[np.int64]: ...
