from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

class Grid(Protocol):
    @property
    def x_min_m(self) -> float: ...
    @property
    def y_min_m(self) -> float: ...
    @property
    def step_m(self) -> float: ...
    @property
    def z_m(self) -> NDArray[np.float32]: ...

def first_meetings(
    grid: Grid, centre: Numbers, directions: Numbers, tried: Numbers, parts: Numbers, refinements: int, depths: Numbers
) -> None: ...
