import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

def mark_class(tags: Image, of_class: Image, marks: Image) -> None: ...
