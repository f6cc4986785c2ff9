import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

def region_distances(
    labels: NDArray[np.int32], of_region: NDArray[np.bool_], distances_m: Float32, noise: Float32
) -> tuple[Float32, Float32]: ...
