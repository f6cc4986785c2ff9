"""An edge of the transform tree."""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.geometry.arrays import read_only


@dataclass(frozen=True)
class Transform:
    """One edge of the transform tree: ``parent_T_child``."""

    parent: str
    child: str
    parent_T_child: Float

    def __post_init__(self) -> None:
        read_only(self.parent_T_child, np.float64, (4, 4), "parent_T_child")
