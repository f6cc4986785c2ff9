import numpy as np
from numpy.typing import NDArray

def median_places(
    cell: NDArray[np.int32], values: NDArray[np.float32], cells: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]: ...
