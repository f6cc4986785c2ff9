import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

def facing_edges(marked: Image, road: Image, towards: int, fringe: int) -> NDArray[np.float64]: ...
