import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

def normal_equations(
    first: NDArray[np.intp], values: Float, weights: Float, targets: Float, count: int
) -> tuple[Float, Float]: ...
