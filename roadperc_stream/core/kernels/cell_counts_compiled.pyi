import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.cell_counts_plain import Cells
from roadperc_stream.core.kernels.ray_points_plain import Rays

def count_points(
    cells: Cells,
    depth_m: NDArray[np.float32],
    rays: Rays,
    abd: NDArray[np.float32],
    height_m: NDArray[np.float32] | None,
    drivable: NDArray[np.uint8],
    tags: NDArray[np.uint8],
    obstacle_tags: NDArray[np.uint8],
    free: NDArray[np.int64],
    occupied: NDArray[np.int64],
) -> None: ...
