"""A strip of text at the top of a frame's overlay: what its numbers are, and what the colours mean."""

from collections.abc import Iterable, Iterator
from typing import Final

import cv2
import numpy as np

from roadperc_stream.core.datatypes import Absent, Image, Object, Objects
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.canvas import BEHIND_TEXT, Colour, Pen, text_size, write
from roadperc_stream.output.drawing.colours import bgr
from roadperc_stream.schemas.columns import FrameMetrics

Phrase = tuple[str, Colour]
"""A few words that stay on one line, and their colour."""
_PLAIN: Final[Colour] = (240, 240, 240)
_SHADE: Final = 0.7
_GAP_CHARACTERS: Final = 1.0
"""Between two phrases, in heights of the text."""
LEGEND: Final[tuple[Phrase, ...]] = (
    ("drivable", bgr(colours.DRIVABLE)),
    ("lane", bgr(colours.BOUNDARY["measured"])),
    ("held", bgr(colours.BOUNDARY["held"])),
    ("raw", bgr(colours.RAW_LINE)),
    ("object kept", bgr(colours.OBJECT["kept"])),
    ("not judged", bgr(colours.OBJECT["unjudged"])),
    ("dropped", bgr(colours.OBJECT["dropped"])),
)


def draw_strip(canvas: Image, metrics: FrameMetrics, objects: Objects | Absent, since_start_s: float) -> None:
    """Write a frame's numbers and the legend over the topmost rows; a narrow image takes more lines.

    Args:
        canvas: (H, W, 3) uint8, drawn into.
        metrics: the frame's row; what is null there is left out.
        objects: the frame's objects, of which the nearest and the most urgent are named.
        since_start_s: the frame's time, from the first frame.
    """
    pen = Pen.of(canvas, 1.0)
    numbers, legend = _lines(canvas, frame_phrases(metrics, objects, since_start_s), pen), _lines(canvas, LEGEND, pen)
    lines = [*numbers, *legend]
    shaded = canvas[: len(lines) * pen.row_px]
    shaded[...] = cv2.addWeighted(shaded, 1 - _SHADE, np.full_like(shaded, BEHIND_TEXT), _SHADE, 0)
    for row, line in enumerate(lines):
        for x, (text, colour) in line:
            write(canvas, text, (x, row * pen.row_px), colour, pen)


def frame_phrases(metrics: FrameMetrics, objects: Objects | Absent, since_start_s: float) -> Iterator[Phrase]:
    """What a frame's row says, and of which objects it speaks, the most telling numbers first."""
    yield f"frame {metrics.frame}", _PLAIN
    yield f"{since_start_s:.2f} s", _PLAIN
    yield from _lane("left", metrics.lane_left_status, metrics.lane_left_offset_m)
    yield from _lane("right", metrics.lane_right_status, metrics.lane_right_offset_m)
    if not isinstance(objects, Absent):
        yield from _objects(objects.nearest, objects.most_urgent)
    yield from _odometry(metrics)
    if metrics.surface_source is not None:
        yield f"surface: {metrics.surface_source}", _PLAIN


def _lane(side: str, status: str | None, offset_m: float | None) -> Iterator[Phrase]:
    if status is not None:
        said = status if offset_m is None else f"{offset_m:+.2f} m"
        yield f"lane {side} {said}", bgr(colours.BOUNDARY[status])


def _objects(nearest: Object | None, urgent: Object | None) -> Iterator[Phrase]:
    """The most urgent object before the nearest: the time to impact need not be the nearest one's."""
    if urgent is not None and urgent is nearest:
        yield f"nearest {_named(urgent)}, impact in {urgent.time_to_impact_s:.1f} s", _PLAIN
        return
    if urgent is not None:
        yield f"impact: {_named(urgent)} in {urgent.time_to_impact_s:.1f} s", _PLAIN
    if nearest is not None:
        yield f"nearest {_named(nearest)}", _PLAIN


def _named(item: Object) -> str:
    """Label and distance, as far as there is one."""
    name = item.detection.label or "object"
    return name if item.distance_m is None else f"{name} {item.distance_m:.1f} m"


def _odometry(metrics: FrameMetrics) -> Iterator[Phrase]:
    if metrics.step_m is not None:
        yield f"step {metrics.step_m:.2f} m", _PLAIN
    elif metrics.odometry_status is not None:
        said = "without scale" if metrics.odometry_status == "tracked" else metrics.odometry_status
        yield f"odometry {said}", bgr(colours.ORANGE) if metrics.odometry_status == "lost" else _PLAIN


def _lines(canvas: Image, phrases: Iterable[Phrase], pen: Pen) -> list[list[tuple[int, Phrase]]]:
    """The phrases and the columns they begin at, as many on a line as fit."""
    lines: list[list[tuple[int, Phrase]]] = [[]]
    x = 0
    for phrase in phrases:
        width, _ = text_size(canvas, phrase[0], pen)
        if lines[-1] and x + width > pen.size[0]:
            lines.append([])
            x = 0
        lines[-1].append((x, phrase))
        x += width + round(_GAP_CHARACTERS * pen.text_px)
    return lines
