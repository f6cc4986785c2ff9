import numpy as np
from numpy.typing import NDArray

def doubled(half: NDArray[np.float32], step_px: float) -> NDArray[np.float32]: ...
