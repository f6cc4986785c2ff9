"""Classes of drawn boxes and lines: their names and colours stand in annotation contexts."""

from enum import IntEnum
from typing import Final

import rerun as rr

from roadperc_stream.core.semantics import Colour
from roadperc_stream.output.drawing import colours
from roadperc_stream.view.rerun.entry import annotation_context

_TRUE: Final[Colour] = (255, 255, 255)


class BoxClass(IntEnum):
    """What became of a detection; ``DETECTED`` and ``TRUE`` are not for the chain to judge."""

    KEPT = 0
    UNVERIFIED = 1
    DROPPED = 2
    DETECTED = 3
    TRUE = 4


class LineClass(IntEnum):
    """Where a line comes from."""

    MEASURED = 0
    HELD = 1
    LOST = 2
    RAW = 3
    PROPOSAL = 4
    TRUE = 5


_BOX_COLOURS: Final = (*(colours.OBJECT[verdict] for verdict in ("kept", "unverified", "dropped")), colours.CYAN, _TRUE)
_LINE_COLOURS: Final = (
    *(colours.BOUNDARY[status] for status in ("measured", "held", "lost")),
    colours.RAW_LINE,
    colours.PROPOSED_LINE,
    _TRUE,
)


def box_context() -> rr.AnnotationContext:
    """Names and colours of ``BoxClass``."""
    return annotation_context((c.name.lower() for c in BoxClass), _BOX_COLOURS)


def line_context() -> rr.AnnotationContext:
    """Names and colours of ``LineClass``."""
    return annotation_context((c.name.lower() for c in LineClass), _LINE_COLOURS)
