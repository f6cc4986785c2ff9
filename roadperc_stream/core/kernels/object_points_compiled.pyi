import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]
Numbers = tuple[float, float, float, float]

def object_points(
    depth_m: NDArray[np.float32],
    camera: Numbers,
    box: tuple[int, int, int, int, int],
    of_class: tuple[Image, Image] | None,
    distance_m: float,
    behind_m: tuple[float, float],
    ego_T_camera: Float,
    circle: Numbers,
) -> tuple[Float, Float, Float]: ...
def mean_direction(points: Float, ranges_m: Float, most_m: float) -> tuple[float, float]: ...
