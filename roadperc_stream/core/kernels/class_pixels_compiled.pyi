import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

def mark_together(tags: Image, of_class: Image, least: int, marked: Image) -> None: ...
def count_of_class(tags: Image, of_class: Image) -> int: ...
