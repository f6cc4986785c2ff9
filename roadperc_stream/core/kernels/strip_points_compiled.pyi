import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.ray_points_plain import Rays
from roadperc_stream.core.kernels.strip_points_plain import Strip

def points_on_strip(
    strip: Strip,
    depth_m: NDArray[np.float32],
    rays: Rays,
    abd: NDArray[np.float32],
    among: NDArray[np.uint8],
) -> tuple[NDArray[np.float32], NDArray[np.int32]]: ...
