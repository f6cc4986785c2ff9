"""An edge of the transform tree."""

from dataclasses import dataclass

from roadperc_stream.core.geometry import Float


@dataclass(frozen=True)
class Transform:
    """One edge of the transform tree: ``parent_T_child``."""

    parent: str
    child: str
    parent_T_child: Float
