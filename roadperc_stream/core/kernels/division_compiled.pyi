import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.division_plain import Divided

def divided(log_depth: NDArray[np.float32], of_class: NDArray[np.uint8], jumps: NDArray[np.float32]) -> Divided: ...
