import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.robust_quadratic_plain import (
    Following,
    Numbers,
    Points,
    Quadratic,
    State,
    Weighing,
)

def follow(points: Points, first: State, how: Following, weighing: Weighing) -> Quadratic | None: ...
def rows_beside(
    points: Points, state: State, inward: float, reach: float, asides: tuple[float, ...]
) -> tuple[int, ...]: ...
def counts_aside(x: Numbers, y: Numbers, state: State, inward: float, edges: Numbers) -> NDArray[np.intp]: ...
