import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.cell_counts_plain import Cells, KnownPixels
from roadperc_stream.core.kernels.ray_points_plain import Rays

def count_points(
    cells: Cells,
    pixels: KnownPixels,
    rays: Rays,
    abd: NDArray[np.float32],
    obstacle_tags: NDArray[np.uint8],
    free: NDArray[np.int64],
    occupied: NDArray[np.int64],
) -> None: ...
