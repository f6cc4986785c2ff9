import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.reprojection_plain import Projection
from roadperc_stream.core.kernels.visible_cells_plain import Middles

def mark_visible(
    projection: Projection,
    camera_T_ego: NDArray[np.float64],
    middles: Middles,
    drivable: NDArray[np.uint8],
    depth_m: NDArray[np.float32] | None,
    tolerance: float,
    slack_m: float,
    visible: NDArray[np.uint8],
) -> None: ...
