import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]

def object_points(
    depth_m: NDArray[np.float32],
    x: Float,
    y: Float,
    of_class: tuple[Image, Image] | None,
    distance_m: float,
    behind_m: tuple[float, float],
) -> tuple[Float, Float]: ...
def mean_direction(points: Float, ranges_m: Float, most_m: float) -> tuple[float, float]: ...
