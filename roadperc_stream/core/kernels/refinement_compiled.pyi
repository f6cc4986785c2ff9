import numpy as np
from numpy.typing import NDArray

def refined_disparities(
    sixteenths: NDArray[np.int16], left: NDArray[np.uint8], right: NDArray[np.uint8], size: int
) -> NDArray[np.float32]: ...
