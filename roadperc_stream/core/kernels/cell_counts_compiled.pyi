import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.cell_counts_plain import Cells

def count_points(
    cells: Cells,
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    height: NDArray[np.float32],
    drivable: NDArray[np.uint8],
    obstacles: NDArray[np.uint8],
    free: NDArray[np.int64],
    occupied: NDArray[np.int64],
) -> None: ...
