"""Draws lanes, detections and objects over the image and in 3D; annotation contexts name and colour their classes."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import rerun as rr

from roadperc_stream.geometry import Camera, Float, inside_image
from roadperc_stream.model import EGO, Boundary, Box, Detection, Lanes, Object, Objects
from roadperc_stream.model.tag_tables import Colour
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.annotations import caption, slabs
from roadperc_stream.output.drawing.captions import caption_places, viewer_text_size
from roadperc_stream.view.rerun.tree import Entry, SceneState, annotation_context

_TRUE: Final[Colour] = (255, 255, 255)


_BOX_COLOURS: Final[Mapping[str, Colour]] = {**colours.OBJECT, "detected": colours.CYAN, "true": _TRUE}
"""By the verdict on a detection; ``detected`` and ``true`` ones have none."""
_LINE_COLOURS: Final[Mapping[str, Colour]] = {
    **colours.BOUNDARY,
    "raw": colours.RAW_LINE,
    "proposal": colours.PROPOSED_LINE,
    "true": _TRUE,
}
"""By the status or the origin of a line."""
_BOXES: Final = annotation_context(_BOX_COLOURS, _BOX_COLOURS.values())
_LINES: Final = annotation_context(_LINE_COLOURS, _LINE_COLOURS.values())
_BOX_IDS: Final = {name: number for number, name in enumerate(_BOX_COLOURS)}
_LINE_IDS: Final = {name: number for number, name in enumerate(_LINE_COLOURS)}
_KEPT_PX, _DROPPED_PX = 1.5, 0.75
_CAPTION_MARGIN = (1.25, 1.8)
"""Size of the viewer's captions relative to their text, in columns and rows."""


def detections(entity: str, _role: str, payload: Sequence[Detection], state: SceneState) -> Iterator[Entry]:
    """Draw the boxes of the detector."""
    texts = [f"{detection.label} {detection.score:.2f}" for detection in payload]
    yield Entry(entity, _BOXES)
    boxes = _boxes([d.box_px for d in payload], ["detected"] * len(payload), texts, shown=True)
    yield Entry(entity, boxes, state.image_frame(state.reference, ""))


def objects(entity: str, role: str, payload: Objects, state: SceneState) -> Iterator[Entry]:
    """Draw boxes by verdict in the image, and kept objects with a distance in 3D."""
    true = role.startswith("truth")
    judged = [(item, "true" if true else item.verdict) for item in payload.objects]
    frame, camera = state.image_frame(state.reference, ""), state.front
    yield Entry(entity, _BOXES)
    kept = [(item, box) for item, box in judged if item.kept or true]
    dropped = [(item, box) for item, box in judged if not (item.kept or true)]
    yield Entry(f"{entity}/annotations/dropped", _judged(dropped), frame)
    yield Entry(f"{entity}/annotations/kept", _judged(kept), frame)
    if camera is not None:
        places = _caption_places(kept, camera)
        yield Entry(f"{entity}/annotations/captions", _captions(kept, places), frame)
        yield from _in_space(f"{entity}/scene", kept, places, camera)


def _caption_places(kept: Sequence[tuple[Object, str]], camera: Camera) -> tuple[Box | None, ...]:
    """Places for the captions, which have a wider margin in this viewer."""
    items = [item for item, _ in kept]
    sizes = [viewer_text_size(camera, caption(item)) for item in items]
    wider = [(_CAPTION_MARGIN[0] * width, _CAPTION_MARGIN[1] * height) for width, height in sizes]
    return caption_places((camera.width, camera.height), items, [item.detection.box_px for item in items], wider)


def _captions(kept: Sequence[tuple[Object, str]], places: Sequence[Box | None]) -> rr.Points2D:
    """The captions that have a place, below their points; hovering over a box also shows its caption."""
    shown = [(caption(item), box, place) for (item, box), place in zip(kept, places, strict=True) if place]
    return rr.Points2D(
        np.array([((place.x_min + place.x_max) / 2, place.y_min) for _, _, place in shown]).reshape(-1, 2),
        labels=[text for text, _, _ in shown],
        class_ids=[_BOX_IDS[box] for _, box, _ in shown],
        show_labels=True,
        radii=rr.Radius.ui_points(0.0),
        draw_order=50.0,
    )


def _judged(objects: Sequence[tuple[Object, str]]) -> rr.Boxes2D:
    boxes_px, texts = [item.detection.box_px for item, _ in objects], [caption(item) for item, _ in objects]
    return _boxes(boxes_px, [box for _, box in objects], texts, shown=False)


def _boxes(boxes_px: Sequence[Box], classes: Sequence[str], texts: Sequence[str], *, shown: bool) -> rr.Boxes2D:
    """Half-open boxes in pixels from the image corner; ``shown`` texts are visible without hovering."""
    corners = np.array([(b.x_min, b.y_min, b.x_max, b.y_max) for b in boxes_px], float).reshape(-1, 4)
    return rr.Boxes2D(
        array=corners,
        array_format=rr.Box2DFormat.XYXY,
        class_ids=[_BOX_IDS[name] for name in classes],
        labels=list(texts),
        show_labels=shown,
        radii=rr.Radius.ui_points([_DROPPED_PX if c == "dropped" else _KEPT_PX for c in classes]),
        draw_order=40.0,
    )


def _in_space(
    entity: str, kept: Sequence[tuple[Object, str]], places: Sequence[Box | None], camera: Camera
) -> Iterator[Entry]:
    """Objects with a distance, and captions of those with a caption in the image."""
    near = [(*pair, place) for pair, place in zip(kept, places, strict=True) if pair[0].distance_m]
    centres, sizes = slabs(camera, [item for item, _, _ in near])
    classes, texts = [_BOX_IDS[box] for _, box, _ in near], [caption(item) for item, _, _ in near]
    boxes = rr.Boxes3D(
        centers=centres,
        sizes=sizes,
        class_ids=classes,
        labels=texts,
        show_labels=False,
        radii=rr.Radius.ui_points(1.5),
    )
    yield Entry(entity, boxes, camera.frame_id)
    named = [k for k, (_, _, place) in enumerate(near) if place]
    captions = rr.Points3D(
        centres[named],
        labels=[texts[k] for k in named],
        class_ids=[classes[k] for k in named],
        show_labels=True,
        radii=rr.Radius.ui_points(0.0),
    )
    yield Entry(f"{entity}/captions", captions, camera.frame_id)


_HALF_PIXEL = 0.5
_SMOOTHED_PX, _RAW_PX, _PROPOSAL_PX = 2.0, 1.0, 0.5
_ON_THE_ROAD_M, _TRUE_M = 0.09, 0.03


def lanes(entity: str, role: str, payload: Lanes, state: SceneState) -> Iterator[Entry]:
    """Draw smoothed, raw and proposed lines in the image, and the boundaries in the ego frame."""
    yield Entry(entity, _LINES)
    yield from _on_the_image(f"{entity}/annotations", payload, role, state)
    drawn = [boundary for boundary in payload.boundaries if len(boundary.line_ego_m)]
    strips = rr.LineStrips3D(
        [boundary.line_ego_m for boundary in drawn],
        radii=_TRUE_M if role.startswith("truth") else _ON_THE_ROAD_M,
        class_ids=_classes(drawn, role),
        labels=[_caption(boundary) for boundary in drawn],
        show_labels=False,
    )
    yield Entry(f"{entity}/scene", strips, EGO)


def _on_the_image(entity: str, payload: Lanes, role: str, state: SceneState) -> Iterator[Entry]:
    frame, camera = state.image_frame(state.reference, ""), state.front
    drawn = [boundary for boundary in payload.boundaries if len(boundary.line_px)]
    smoothed = rr.LineStrips2D(
        [_inside(boundary.line_px, camera) + _HALF_PIXEL for boundary in drawn],
        radii=rr.Radius.ui_points(_SMOOTHED_PX),
        class_ids=_classes(drawn, role),
        labels=[_caption(boundary) for boundary in drawn],
        show_labels=False,
        draw_order=30.0,
    )
    raw_px = [_inside(np.reshape(b.raw_px, (2, 2)), camera) for b in payload.boundaries if b.raw_px is not None]
    raw = np.array([line for line in raw_px if len(line)]).reshape(-1, 4)
    yield Entry(f"{entity}/proposals", _segments(payload.proposals_px, "proposal", _PROPOSAL_PX, 10.0), frame)
    yield Entry(f"{entity}/raw", _segments(raw, "raw", _RAW_PX, 20.0), frame)
    yield Entry(f"{entity}/smoothed", smoothed, frame)


def _inside(line_px: Float, camera: Camera | None) -> Float:
    """The part of a line inside the image, because points outside would shift the view."""
    return line_px if camera is None else inside_image(line_px, camera)


def _segments(lines_px: Float, line_class: str, radius: float, draw_order: float) -> rr.LineStrips2D:
    """(N, 4) x1, y1, x2, y2 as N strips."""
    return rr.LineStrips2D(
        [*(lines_px.reshape(-1, 2, 2) + _HALF_PIXEL)],
        radii=rr.Radius.ui_points(radius),
        class_ids=[_LINE_IDS[line_class]] * len(lines_px),
        show_labels=False,
        draw_order=draw_order,
    )


def _classes(boundaries: Sequence[Boundary], role: str) -> list[int]:
    true = role.startswith("truth")
    return [_LINE_IDS["true" if true else boundary.status] for boundary in boundaries]


def _caption(boundary: Boundary) -> str:
    offset = "" if boundary.offset_m is None else f"{boundary.offset_m:+.2f} m"
    return f"{offset} {boundary.outside}".strip()
