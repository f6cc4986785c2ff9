import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.reprojection_plain import Projection, Weighting

def linearise(
    projection: Projection,
    weighting: Weighting,
    points_m: NDArray[np.float64],
    px: NDArray[np.float64],
    this_T_key: NDArray[np.float64],
    residual: NDArray[np.float64],
    derivative: NDArray[np.float64],
    agrees: NDArray[np.uint8],
) -> None: ...
