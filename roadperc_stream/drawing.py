"""What the viewers draw over the image and in 3D: foxglove.ImageAnnotations and foxglove.SceneUpdate."""

from collections.abc import Iterable
from typing import Any, Final

import cv2
import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from roadperc_stream.datatypes import Box, Lanes, Mask, Object, Objects, Surface
from roadperc_stream.geometry import Camera, Float
from roadperc_stream.ground import ground_points, height_at
from roadperc_stream.schemas.protobuf import set_stamp

_GREEN: Final = (0.1, 0.9, 0.3)
_GREY: Final = (0.6, 0.6, 0.6)
_YELLOW: Final = (1.0, 0.9, 0.1)
_ORANGE: Final = (1.0, 0.5, 0.0)
_CYAN: Final = (0.1, 0.8, 1.0)
_STATUS_COLOURS: Final = {"measured": _GREEN, "held": _ORANGE}
_FONT_ROWS: Final = 40
"""A line of text is this part of the image's rows: 24 px of 960."""
_TEXT_UP_TO: Final = 0.8
_PATCH_M: Final = (2.0, 40.0, 4.0)
"""Nearest and farthest x, and half the width."""
_PATCH_STRIPS: Final = 19
_OUTLINE_TOLERANCE_PX: Final = 3.0
_OUTLINE_MAX_M: Final = 60.0


def lane_annotations(stamp_ns: int, camera: Camera, lanes: Lanes) -> bytes:
    """Proposals thin, raw lines, and the smoothed boundaries in the colour of their status."""
    message = ImageAnnotations()
    set_stamp(message, stamp_ns)
    proposals = lanes.proposals_px.reshape(-1, 2)
    if len(proposals):
        _points(message, stamp_ns, PointsAnnotation.LINE_LIST, proposals, _CYAN, 1.0)
    for boundary in lanes.boundaries:
        if boundary.raw_px is not None:
            raw = np.array(boundary.raw_px).reshape(2, 2)
            _points(message, stamp_ns, PointsAnnotation.LINE_STRIP, raw, _YELLOW, 1.0)
        if len(boundary.line_px):
            colour = _STATUS_COLOURS[boundary.status]
            _points(message, stamp_ns, PointsAnnotation.LINE_STRIP, boundary.line_px, colour, 4.0)
            text = f"{boundary.offset_m:+.2f} m {boundary.outside}".strip()
            visible = boundary.line_px[_room_for_text(camera, boundary.line_px)]
            if len(visible):
                _text(message, stamp_ns, camera, visible[0], text, colour)
    return message.SerializeToString()


def object_annotations(stamp_ns: int, camera: Camera, objects: Objects) -> bytes:
    """Boxes of kept detections with their distance, of dropped ones with their share of class pixels."""
    message = ImageAnnotations()
    set_stamp(message, stamp_ns)
    for item in objects.objects:
        colour, thickness = _box_style(item)
        corners = _corners(item.detection.box_px)
        _points(message, stamp_ns, PointsAnnotation.LINE_LOOP, corners, colour, thickness)
        _text(message, stamp_ns, camera, corners[0], caption(item), colour)
    return message.SerializeToString()


def drivable_scene(stamp_ns: int, surface: Surface, camera: Camera, ego_T_camera: Float, mask: Mask) -> bytes:
    """The outline of the drivable pixels on the road, and a patch of the road itself, in the ego frame.

    Args:
        stamp_ns: the frame's time.
        surface: the road, its plane in the frame of ``camera``.
        camera: the camera of the mask.
        ego_T_camera: its mounting.
        mask: (H, W) drivable pixels.
    """
    message = SceneUpdate()
    entity = message.entities.add(frame_id="ego", id="drivable")
    set_stamp(entity, stamp_ns)
    patch = _patch(surface)
    corners = [2 * i + k for i in range(len(patch) // 2 - 1) for k in (0, 1, 3, 0, 3, 2)]
    triangles = entity.triangles.add(color=_color(_GREEN, 0.25), indices=corners)
    triangles.points.extend(_point3(point) for point in patch)
    outline = _outline(surface, camera, ego_T_camera, mask)
    if len(outline):
        line = entity.lines.add(type=LinePrimitive.LINE_LOOP, thickness=2.0, scale_invariant=True, color=_color(_GREEN))
        line.points.extend(_point3(point) for point in outline)
    return message.SerializeToString()


def lanes_scene(stamp_ns: int, lanes: Lanes) -> bytes:
    """The boundaries on the road, in the ego frame."""
    message = SceneUpdate()
    for boundary in lanes.boundaries:
        entity = message.entities.add(frame_id="ego", id=f"lane_{boundary.side}")
        set_stamp(entity, stamp_ns)
        if len(boundary.line_ego_m):
            colour = _color(_STATUS_COLOURS[boundary.status])
            line = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=0.1, color=colour)
            line.points.extend(_point3(point) for point in boundary.line_ego_m)
    return message.SerializeToString()


def _patch(surface: Surface) -> Float:
    """(2 N, 3) ego points on the road, left and right by turns; a plane needs but its corners."""
    near, far, half = _PATCH_M
    ahead = np.linspace(near, far, 2 if surface.height_grid is None else _PATCH_STRIPS + 1)
    x, y = np.repeat(ahead, 2), np.tile((half, -half), len(ahead))
    return np.stack((x, y, height_at(surface, x, y)), axis=-1)


def _outline(surface: Surface, camera: Camera, ego_T_camera: Float, mask: Mask) -> Float:
    """(N, 3) ego points of the largest drivable region's outline; points far away are left out."""
    contours, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not contours:
        return np.empty((0, 3))
    largest = max(contours, key=cv2.contourArea)
    pixels = cv2.approxPolyDP(largest, _OUTLINE_TOLERANCE_PX, closed=True).reshape(-1, 2).astype(float)
    points = ground_points(surface, camera, ego_T_camera, pixels)
    near = np.linalg.norm(np.nan_to_num(points, nan=np.inf), axis=1) < _OUTLINE_MAX_M
    return np.asarray(points[near], float)


def _room_for_text(camera: Camera, pixels: Float) -> Mask:
    """Which of (N, 2) pixels are in the image with room to their right."""
    x, y = pixels.T
    room: Mask = (x >= 0) & (x < _TEXT_UP_TO * camera.width) & (y < camera.height)
    return room


def _box_style(item: Object) -> tuple[tuple[float, float, float], float]:
    """Colour and width: kept ones green, kept ones that nothing could judge yellow, dropped ones thin and grey."""
    if not item.kept:
        return _GREY, 1.0
    return (_YELLOW if item.class_ratio is None else _GREEN), 3.0


def caption(item: Object) -> str:
    """Label, distance and time to impact of an object; of one that was dropped its share of class pixels."""
    parts = [item.detection.label]
    if item.distance_m is not None:
        parts.append(f"{item.distance_m:.1f} m")
    if item.time_to_impact_s is not None:
        parts.append(f"{item.time_to_impact_s:.1f} s")
    if not item.kept and item.class_ratio is not None:
        parts.append(f"{item.class_ratio:.0%}")
    return " ".join(parts)


def _corners(box: Box) -> Float:
    x0, y0, x1, y1 = box.x_min, box.y_min, box.x_max - 1, box.y_max - 1
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def _points(
    message: ImageAnnotations, stamp_ns: int, kind: Any, points: Float, colour: tuple[float, float, float], width: float
) -> None:
    entry = message.points.add(type=kind, outline_color=_color(colour), thickness=width)
    set_stamp(entry, stamp_ns)
    entry.points.extend(Point2(x=x, y=y) for x, y in points.tolist())


def _text(
    message: ImageAnnotations,
    stamp_ns: int,
    camera: Camera,
    position: Iterable[float],
    text: str,
    colour: tuple[float, float, float],
) -> None:
    x, y = position
    entry = message.texts.add(
        position=Point2(x=x, y=y),
        text=text,
        font_size=max(camera.height / _FONT_ROWS, 8.0),
        text_color=_color(colour),
        background_color=_color((0.0, 0.0, 0.0), 0.6),
    )
    set_stamp(entry, stamp_ns)


def _color(rgb: tuple[float, float, float], alpha: float = 1.0) -> Color:
    r, g, b = rgb
    return Color(r=r, g=g, b=b, a=alpha)


def _point3(point: Iterable[float]) -> Point3:
    x, y, z = (float(value) for value in point)
    return Point3(x=x, y=y, z=z)
