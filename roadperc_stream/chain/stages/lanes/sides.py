"""The two sides of the ego lane."""

from roadperc_stream.core.datatypes import Side


def other_side(side: Side) -> Side:
    """The opposite one."""
    return "right" if side == "left" else "left"


def outward(side: Side) -> float:
    """Sign of y on that side of the car."""
    return 1.0 if side == "left" else -1.0
