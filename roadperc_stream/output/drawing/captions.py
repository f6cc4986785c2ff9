"""Places captions and labels of objects in a picture without overlap."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box, Object

_FONT_ROWS: Final = 40
"""The image height is divided by this for the height of a line of text in viewers: 24 px of 960."""
_GLYPH_ASPECT: Final = 0.65
"""Mean width of a letter by the font size, in the typeface of the viewers."""
_LEAST_FONT_PX: Final = 8.0
_LINE_HEIGHT: Final = 1.15
"""Height of a line with its plate by the font size."""
Size = tuple[float, float]
"""Columns and rows, pixels."""


def by_nearness(objects: Sequence[Object]) -> list[int]:
    """Indices of the objects: kept before dropped, then the nearest first, as the nearest matter most."""

    def nearness(index: int) -> tuple[bool, float]:
        item = objects[index]
        return not item.kept, math.inf if item.distance_m is None else item.distance_m

    return sorted(range(len(objects)), key=nearness)


def caption_places(
    image_size: Size, objects: Sequence[Object], boxes: Sequence[Box], text_sizes: Sequence[Size]
) -> tuple[Box | None, ...]:
    """The place of each object's caption: above its box, at the top inside it, or below it. The nearest choose first.

    Sizes are columns and rows, boxes and sizes in pixels of the picture.

    Returns:
        For each object the box of its caption, inside the picture; None if no place is free.
    """
    wanted = [_wanted(image_size, box, size) for box, size in zip(boxes, text_sizes, strict=True)]
    return _nearest_first(objects, wanted)


def _nearest_first(
    objects: Sequence[Object],
    wanted: Sequence[Iterable[Box]],
    others: Sequence[Sequence[Box]] | None = None,
    gap: float = 0.0,
) -> tuple[Box | None, ...]:
    """The first wanted place of each object that is free, or None; the nearest choose first.

    A place covers no other one and none of the object's ``others``, with a gap of this many heights beside it.
    """
    places: list[Box | None] = [None] * len(objects)
    taken: list[Box] = []
    for index in by_nearness(objects):
        covered = [*taken, *(others[index] if others else ())]
        for place in wanted[index]:
            gap_px = gap * (place.y_max - place.y_min)
            apart = Box(place.x_min - gap_px, place.y_min, place.x_max + gap_px, place.y_max)
            if not any(map(apart.meets, covered)):
                places[index] = place
                taken.append(place)
                break
    return tuple(places)


def viewer_font_px(camera: Camera) -> float:
    """Font size of the viewers, in pixels of the camera image."""
    return max(camera.height / _FONT_ROWS, _LEAST_FONT_PX)


def viewer_text_size(camera: Camera, text: str) -> Size:
    """Columns and rows of a text with its plate in a viewer, in pixels of the camera image."""
    font_px = viewer_font_px(camera)
    return _GLYPH_ASPECT * font_px * len(text), _LINE_HEIGHT * font_px


def _wanted(image_size: Size, box: Box, text_size: Size) -> Iterable[Box]:
    """Places for a text at a box inside the picture, the best first."""
    (columns, rows), (width, height) = image_size, text_size
    x = max(min(box.x_min, columns - width), 0.0)
    top, bottom = max(box.y_min, 0.0), min(box.y_max, rows)
    return [Box(x, y, x + width, y + height) for y in (top - height, top, bottom) if 0 <= y <= rows - height]


_MOST_LIFTS: Final = 2
"""A label is at most this many lines of text above its object."""
_LEAST_BOX_AREAS: Final = 6.0
"""An object may have its label inside if its area is more than this many times the label's."""
_GAP: Final = 0.15
"""Gap between a label and the boxes it must not cover, in heights of the label."""


def label_places(
    image_size: Size, top_px: float, objects: Sequence[Object], boxes: Sequence[Box], text_sizes: Sequence[Size]
) -> tuple[Box | None, ...]:
    """The place of each object's label; the nearest objects choose first.

    Candidates in order: above the box, some lines higher (kept objects only), inside a large box, below the box. The
    first one that covers no label and no other kept object is used. A label may cover a large object whose box
    surrounds the middle of the labelled one. ``top_px`` rows at the top are taken. Sizes are columns and rows, boxes
    and sizes in pixels of the picture.

    Returns:
        For each object the place of its label, inside the picture; None if no place is free.
    """
    kept = [(k, box) for k, (box, item) in enumerate(zip(boxes, objects, strict=True)) if item.kept]
    wanted = [
        _wanted_labels(image_size, top_px, box, text_size, kept=item.kept)
        for item, box, text_size in zip(objects, boxes, text_sizes, strict=True)
    ]
    others = [
        [other for k, other in kept if k != index and not _surrounds_middle(other, box)]
        for index, box in enumerate(boxes)
    ]
    return _nearest_first(objects, wanted, others, _GAP)


def _surrounds_middle(outer: Box, box: Box) -> bool:
    x, y = (box.x_min + box.x_max) / 2, (box.y_min + box.y_max) / 2
    return outer.area > box.area and outer.x_min < x < outer.x_max and outer.y_min < y < outer.y_max


def _wanted_labels(image_size: Size, top_px: float, box: Box, text_size: Size, *, kept: bool) -> Iterator[Box]:
    """Places for a label at a box inside the picture, the best first."""
    (columns, rows), (width, height) = image_size, text_size
    gap = _GAP * height
    above = box.y_min - height - gap
    lifted = [above - k * (height + gap) for k in range(_MOST_LIFTS + 1 if kept else 1)]
    inside = [box.y_min + gap] if box.area > _LEAST_BOX_AREAS * width * height else []
    for y in (*lifted, *inside, box.y_max + gap):
        margin = gap if y in inside else 0.0
        for left in (box.x_min + margin, (box.x_min + box.x_max - width) / 2, box.x_max - width):
            x = max(min(left, columns - width), 0.0)
            if top_px <= y and y + height <= rows:
                yield Box(x, y, x + width, y + height)
