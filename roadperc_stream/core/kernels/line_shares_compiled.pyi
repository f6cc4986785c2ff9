import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

def line_shares(lines: Float, mask: NDArray[np.uint8], margin: int) -> Float: ...
