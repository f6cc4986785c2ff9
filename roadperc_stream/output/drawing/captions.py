"""Which objects are named in a picture, and where: text that lies over other text can be read by nobody."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from roadperc_stream.core.datatypes import Box, Object
from roadperc_stream.core.geometry import Camera

_FONT_ROWS: Final = 40
"""A line of text is this part of the image's rows in the viewers: 24 px of 960."""
_GLYPH_ASPECT: Final = 0.65
"""Width of a letter by the font's size, in the viewers' typeface."""
_LEAST_FONT_PX: Final = 8.0
_LINE_HEIGHT: Final = 1.15
"""Height of a line with the plate behind it by the font's size."""
Size = tuple[float, float]
"""Columns and rows, pixels."""


def by_nearness(objects: Sequence[Object]) -> list[int]:
    """The objects' indices: those kept before those dropped, then the nearest first, for they matter most."""
    return sorted(range(len(objects)), key=lambda index: _nearness(objects[index]))


def caption_places(
    image_size: Size, objects: Sequence[Object], boxes: Sequence[Box], text_sizes: Sequence[Size]
) -> tuple[Box | None, ...]:
    """Where each object's caption fits beside those of nearer ones: above its box, in it at the top, or below.

    Args:
        image_size: columns and rows of the picture.
        objects: in any order.
        boxes: their boxes in the picture's pixels.
        text_sizes: columns and rows their captions take there.

    Returns:
        For each object the box its caption takes, inside the picture; None where no place is free.
    """

    def free_place(index: int, taken: Sequence[Box]) -> Box | None:
        wanted = _wanted(image_size, boxes[index], text_sizes[index])
        return next((place for place in wanted if not any(map(place.meets, taken))), None)

    return nearest_first(objects, free_place)


def nearest_first(
    objects: Sequence[Object], free_place: Callable[[int, Sequence[Box]], Box | None]
) -> tuple[Box | None, ...]:
    """Each object's place, None where there is none; the nearest have the first choice.

    Args:
        objects: in any order.
        free_place: from an object's index and the places of those before it, its own.
    """
    places: list[Box | None] = [None] * len(objects)
    taken: list[Box] = []
    for index in by_nearness(objects):
        place = places[index] = free_place(index, taken)
        taken += [] if place is None else [place]
    return tuple(places)


def viewer_font_px(camera: Camera) -> float:
    """Size of the viewers' text, in pixels of the camera's image."""
    return max(camera.height / _FONT_ROWS, _LEAST_FONT_PX)


def viewer_text_size(camera: Camera, text: str) -> Size:
    """Columns and rows that a text with the plate behind it takes in a viewer, in pixels of the camera's image."""
    font_px = viewer_font_px(camera)
    return _GLYPH_ASPECT * font_px * len(text), _LINE_HEIGHT * font_px


def _wanted(image_size: Size, box: Box, text_size: Size) -> Iterable[Box]:
    """The places for a text at a box that lie inside the picture, the best first."""
    (columns, rows), (width, height) = image_size, text_size
    x = max(min(box.x_min, columns - width), 0.0)
    top, bottom = max(box.y_min, 0.0), min(box.y_max, rows)
    return [Box(x, y, x + width, y + height) for y in (top - height, top, bottom) if 0 <= y <= rows - height]


def _nearness(item: Object) -> tuple[bool, float]:
    return not item.kept, math.inf if item.distance_m is None else item.distance_m
