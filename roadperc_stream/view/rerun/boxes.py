"""Detections and judged objects over the image, and the kept ones in space."""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr

from roadperc_stream.core.datatypes import Box, Detection, Object, Objects
from roadperc_stream.core.geometry import Camera
from roadperc_stream.output.drawing.annotations import box_in_space, caption
from roadperc_stream.output.drawing.captions import caption_places, viewer_text_size
from roadperc_stream.view.rerun.classes import BoxClass, box_context
from roadperc_stream.view.rerun.entry import Entry, SceneState

_KEPT_PX, _DROPPED_PX = 1.5, 0.75
_CAPTION_MARGIN = (1.25, 1.8)
"""Columns and rows that the viewer's captions take beside those of the text."""


def detections(entity: str, _role: str, payload: Sequence[Detection], world: SceneState) -> Iterator[Entry]:
    """What the detector said."""
    texts = [f"{detection.label} {detection.score:.2f}" for detection in payload]
    yield Entry(entity, box_context())
    boxes = _boxes([d.box_px for d in payload], [BoxClass.DETECTED] * len(payload), texts, shown=True)
    yield Entry(entity, boxes, world.image_frame(world.reference, ""))


def objects(entity: str, role: str, payload: Objects, world: SceneState) -> Iterator[Entry]:
    """Boxes distinguished by what became of them; the kept ones of known distance in the camera's frame."""
    true = role.startswith("truth")
    judged = [(item, BoxClass.TRUE if true else BoxClass[item.verdict.upper()]) for item in payload.objects]
    frame, camera = world.image_frame(world.reference, ""), world.front
    yield Entry(entity, box_context())
    kept = [(item, box) for item, box in judged if item.kept or true]
    dropped = [(item, box) for item, box in judged if not (item.kept or true)]
    yield Entry(f"{entity}/annotations/dropped", _judged(dropped), frame)
    yield Entry(f"{entity}/annotations/kept", _judged(kept), frame)
    if camera is not None:
        places = _caption_places(kept, camera)
        yield Entry(f"{entity}/annotations/captions", _captions(kept, places), frame)
        yield from _in_space(f"{entity}/scene", kept, places, camera)


def _caption_places(kept: Sequence[tuple[Object, BoxClass]], camera: Camera) -> tuple[Box | None, ...]:
    """Space for the captions, which are larger here than elsewhere by the margin around them."""
    items = [item for item, _ in kept]
    sizes = [viewer_text_size(camera, caption(item)) for item in items]
    wider = [(_CAPTION_MARGIN[0] * width, _CAPTION_MARGIN[1] * height) for width, height in sizes]
    return caption_places((camera.width, camera.height), items, [item.detection.box_px for item in items], wider)


def _captions(kept: Sequence[tuple[Object, BoxClass]], places: Sequence[Box | None]) -> rr.Points2D:
    """Captions that fit, below their points; hovering over a box shows its caption as well."""
    shown = [(caption(item), box, place) for (item, box), place in zip(kept, places, strict=True) if place]
    return rr.Points2D(
        np.array([((place.x_min + place.x_max) / 2, place.y_min) for _, _, place in shown]).reshape(-1, 2),
        labels=[text for text, _, _ in shown],
        class_ids=[box for _, box, _ in shown],
        show_labels=True,
        radii=rr.Radius.ui_points(0.0),
        draw_order=50.0,
    )


def _judged(objects: Sequence[tuple[Object, BoxClass]]) -> rr.Boxes2D:
    boxes_px, texts = [item.detection.box_px for item, _ in objects], [caption(item) for item, _ in objects]
    return _boxes(boxes_px, [box for _, box in objects], texts, shown=False)


def _boxes(boxes_px: Sequence[Box], classes: Sequence[BoxClass], texts: Sequence[str], *, shown: bool) -> rr.Boxes2D:
    """Half-open boxes, counted from the image's corner as they stand; their texts shown, or shown on hovering only."""
    corners = np.array([(b.x_min, b.y_min, b.x_max, b.y_max) for b in boxes_px], float).reshape(-1, 4)
    return rr.Boxes2D(
        array=corners,
        array_format=rr.Box2DFormat.XYXY,
        class_ids=list(classes),
        labels=list(texts),
        show_labels=shown,
        radii=rr.Radius.ui_points([_DROPPED_PX if c is BoxClass.DROPPED else _KEPT_PX for c in classes]),
        draw_order=40.0,
    )


def _in_space(
    entity: str, kept: Sequence[tuple[Object, BoxClass]], places: Sequence[Box | None], camera: Camera
) -> Iterator[Entry]:
    """Those of known distance, and the captions of those that have one in the image."""
    near = [(*pair, place) for pair, place in zip(kept, places, strict=True) if pair[0].distance_m]
    slabs = [box_in_space(camera, item.detection.box_px, item.distance_m or 0.0) for item, _, _ in near]
    centres = np.array([centre for centre, _ in slabs]).reshape(-1, 3)
    classes, texts = [box for _, box, _ in near], [caption(item) for item, _, _ in near]
    boxes = rr.Boxes3D(
        centers=centres,
        sizes=np.array([size for _, size in slabs]).reshape(-1, 3),
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
