"""Where the objects' labels go in a picture: over no other label, and over no object that is kept."""

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import Final

from roadperc_stream.core.datatypes import Box, Object
from roadperc_stream.output.drawing.captions import Size, nearest_first

_MOST_LIFTS: Final = 2
"""A label finds its place this many lines of text above its object at most."""
_LEAST_BOX_AREAS: Final = 6.0
"""An object of this many times a label's area may have it inside."""
_GAP: Final = 0.15
"""Between a label and what it does not cover, in heights of the label."""


def label_places(
    image_size: Size, top_px: float, objects: Sequence[Object], boxes: Sequence[Box], text_sizes: Sequence[Size]
) -> tuple[Box | None, ...]:
    """The place of each object's label, the nearest having the first choice.

    It is above the box, some lines higher (for objects that are kept), inside a large box, or below it: the first of
    these where it covers no label and no other object that is kept. A large object whose box surrounds this one's
    middle may be covered.

    Args:
        image_size: columns and rows of the picture.
        top_px: rows at the top that are taken.
        objects: in any order.
        boxes: their boxes in the picture's pixels.
        text_sizes: columns and rows their labels take there.

    Returns:
        For each object the place of its label, inside the picture; None where there is none.
    """
    kept = [(k, box) for k, (box, item) in enumerate(zip(boxes, objects, strict=True)) if item.kept]
    rows = top_px, image_size[1]

    def free_place(index: int, taken: Sequence[Box]) -> Box | None:
        box = boxes[index]
        covered = [*taken, *(other for k, other in kept if k != index and not _surrounds_middle(other, box))]
        wanted = _wanted(box, text_sizes[index], kept=objects[index].kept)
        inside = (_moved_inside(place, image_size) for place in wanted)
        return next((place for place in inside if _is_free(place, rows, covered)), None)

    return nearest_first(objects, free_place)


def _surrounds_middle(outer: Box, box: Box) -> bool:
    x, y = (box.x_min + box.x_max) / 2, (box.y_min + box.y_max) / 2
    return outer.area > box.area and outer.x_min < x < outer.x_max and outer.y_min < y < outer.y_max


def _wanted(box: Box, text_size: Size, *, kept: bool) -> Iterator[Box]:
    """Places for a label at a box, the best first."""
    width, height = text_size
    gap = _GAP * height
    above = box.y_min - height - gap
    lifted = [above - k * (height + gap) for k in range(_MOST_LIFTS + 1 if kept else 1)]
    inside = [box.y_min + gap] if box.area > _LEAST_BOX_AREAS * width * height else []
    for y in chain(lifted, inside, [box.y_max + gap]):
        margin = gap if y in inside else 0.0
        for x in (box.x_min + margin, (box.x_min + box.x_max - width) / 2, box.x_max - width):
            yield Box(x, y, x + width, y + height)


def _moved_inside(place: Box, image_size: Size) -> Box:
    """The place moved sideways into the picture."""
    width = place.x_max - place.x_min
    x = max(min(place.x_min, image_size[0] - width), 0.0)
    return Box(x, place.y_min, x + width, place.y_max)


def _is_free(place: Box, rows: tuple[float, float], covered: Sequence[Box]) -> bool:
    gap = _GAP * (place.y_max - place.y_min)
    apart = Box(place.x_min - gap, place.y_min, place.x_max + gap, place.y_max)
    return rows[0] <= place.y_min and place.y_max <= rows[1] and not any(_meet(apart, box) for box in covered)


def _meet(a: Box, b: Box) -> bool:
    return a.y_min < b.y_max and b.y_min < a.y_max and a.x_min < b.x_max and b.x_min < a.x_max
