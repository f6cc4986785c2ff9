"""The ego lane's boundaries over the image and on the road."""

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr

from roadperc_stream.core.datatypes import EGO, Boundary, Lanes
from roadperc_stream.core.geometry import Camera, Float
from roadperc_stream.view.rerun.classes import LineClass, line_context
from roadperc_stream.view.rerun.entry import Entry, SceneState

_HALF_PIXEL = 0.5
_SMOOTHED_PX, _RAW_PX, _PROPOSAL_PX = 2.0, 1.0, 0.5
_ON_THE_ROAD_M, _TRUE_M = 0.09, 0.03
_PARTS = 20
"""Into so many a metre of line is cut to end it at the image's edge."""


def lanes(entity: str, role: str, payload: Lanes, world: SceneState) -> Iterator[Entry]:
    """Smoothed, raw and proposed lines in the image, and the boundaries in the ego frame."""
    yield Entry(entity, line_context())
    yield from _on_the_image(f"{entity}/annotations", payload, role, world)
    drawn = [boundary for boundary in payload.boundaries if len(boundary.line_ego_m)]
    strips = rr.LineStrips3D(
        [boundary.line_ego_m for boundary in drawn],
        radii=_TRUE_M if role.startswith("truth") else _ON_THE_ROAD_M,
        class_ids=_classes(drawn, role),
        labels=[_caption(boundary) for boundary in drawn],
        show_labels=False,
    )
    yield Entry(f"{entity}/scene", strips, EGO)


def _on_the_image(entity: str, payload: Lanes, role: str, world: SceneState) -> Iterator[Entry]:
    frame, camera = world.image_frame(world.reference, ""), world.front
    drawn = [boundary for boundary in payload.boundaries if len(boundary.line_px)]
    smoothed = rr.LineStrips2D(
        [_inside(boundary.line_px, camera) + _HALF_PIXEL for boundary in drawn],
        radii=rr.Radius.ui_points(_SMOOTHED_PX),
        class_ids=_classes(drawn, role),
        labels=[_caption(boundary) for boundary in drawn],
        show_labels=False,
        draw_order=30.0,
    )
    raw = np.array([b.raw_px for b in payload.boundaries if b.raw_px is not None]).reshape(-1, 4)
    yield Entry(f"{entity}/proposals", _segments(payload.proposals_px, LineClass.PROPOSAL, _PROPOSAL_PX, 10.0), frame)
    yield Entry(f"{entity}/raw", _segments(raw, LineClass.RAW, _RAW_PX, 20.0), frame)
    yield Entry(f"{entity}/smoothed", smoothed, frame)


def _inside(line_px: Float, camera: Camera | None) -> Float:
    """The part of an (N, 2) line that the image shows: what lies beside it would shift the view."""
    if camera is None:
        return line_px
    places = np.arange(len(line_px))
    fine = np.linspace(0, len(line_px) - 1, _PARTS * (len(line_px) - 1) + 1)
    line = np.stack([np.interp(fine, places, column) for column in line_px.T], axis=-1)
    corner = line + _HALF_PIXEL
    shown = ((corner >= 0) & (corner < (camera.width, camera.height))).all(axis=1)
    return np.asarray(line[shown], float)


def _segments(lines_px: Float, line_class: LineClass, radius: float, draw_order: float) -> rr.LineStrips2D:
    """(N, 4) x1, y1, x2, y2 as N strips."""
    return rr.LineStrips2D(
        [*(lines_px.reshape(-1, 2, 2) + _HALF_PIXEL)],
        radii=rr.Radius.ui_points(radius),
        class_ids=[line_class] * len(lines_px),
        show_labels=False,
        draw_order=draw_order,
    )


def _classes(boundaries: Sequence[Boundary], role: str) -> list[LineClass]:
    true = role.startswith("truth")
    return [LineClass.TRUE if true else LineClass[boundary.status.upper()] for boundary in boundaries]


def _caption(boundary: Boundary) -> str:
    offset = "" if boundary.offset_m is None else f"{boundary.offset_m:+.2f} m"
    return f"{offset} {boundary.outside}".strip()
