"""Encodes results for viewers: foxglove.ImageAnnotations over the image, foxglove.SceneUpdate in 3D."""

from collections.abc import Iterable, Sequence
from functools import cache, lru_cache
from typing import Any, Final

import cv2
import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, inside_image, rays, transform
from roadperc_stream.geometry.ground import ground_points, height_at
from roadperc_stream.geometry.rotations import quaternion
from roadperc_stream.model import EGO, Box, Lanes, Mask, Object, Objects, Surface
from roadperc_stream.model.tag_tables import Colour
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.captions import by_nearness, caption_places, viewer_font_px, viewer_text_size
from roadperc_stream.schemas.protobuf import set_stamp

_FAINT: Final = 0.45
"""Opacity of the proposals: there are many, under the few lines merged from them."""
_TEXT_UP_TO: Final = 0.8
"""Texts start left of this share of the image's columns, because they need space on their right."""
_PATCH_M: Final = (2.0, 40.0, 4.0)
"""Nearest and farthest x, and half the width."""
_PATCH_STRIPS: Final = 19
_OUTLINE_TOLERANCE_PX: Final = 3.0
_OUTLINE_MAX_M: Final = 60.0
_SLAB_M: Final = 0.2
_CAPTION_M: Final = 0.7


def lane_annotations(stamp_ns: int, camera: Camera, lanes: Lanes) -> bytes:
    """Encode proposals (thin and faint), raw lines, and smoothed boundaries in the colour of their status."""
    message = ImageAnnotations()
    set_stamp(message, stamp_ns)
    proposals = lanes.proposals_px.reshape(-1, 2)
    if len(proposals):
        _points(message, PointsAnnotation.LINE_LIST, proposals, colours.PROPOSED_LINE, 0.5, _FAINT)
    for boundary in lanes.boundaries:
        if boundary.raw_px is not None:
            raw_px = inside_image(np.reshape(boundary.raw_px, (2, 2)), camera)
            if len(raw_px):
                _points(message, PointsAnnotation.LINE_STRIP, raw_px, colours.RAW_LINE, 1.0)
        line_px = inside_image(boundary.line_px, camera)
        if len(line_px):
            colour = colours.BOUNDARY[boundary.status]
            _points(message, PointsAnnotation.LINE_STRIP, line_px, colour, 4.0)
            text = f"{boundary.offset_m:+.2f} m {boundary.outside}".strip()
            x, y = boundary.line_px.T
            visible = boundary.line_px[(x >= 0) & (x < _TEXT_UP_TO * camera.width) & (y < camera.height)]
            if len(visible):
                _text(message, camera, visible[0], text, colour)
    return message.SerializeToString()


def object_annotations(stamp_ns: int, camera: Camera, objects: Objects) -> bytes:
    """Encode boxes: kept detections with their distance, dropped ones with their share of class pixels.

    The nearest come last and are therefore on top. A caption that does not fit is left out.
    """
    message = ImageAnnotations()
    set_stamp(message, stamp_ns)
    places = _places(camera, objects.objects)
    for index in reversed(by_nearness(objects.objects)):
        item, place = objects.objects[index], places[index]
        colour, thickness = _box_style(item)
        _points(message, PointsAnnotation.LINE_LOOP, _corners(item.detection.box_px), colour, thickness)
        if place is not None:
            _text(message, camera, (place.x_min, place.y_max), caption(item), colour)
    return message.SerializeToString()


def drivable_scene(stamp_ns: int, surface: Surface, camera: Camera, ego_T_camera: Float, mask: Mask) -> bytes:
    """Encode the outline of the drivable area and a patch of the road, in the ego frame.

    Args:
        stamp_ns: the frame's time.
        surface: the road, its plane in the frame of ``camera``.
        camera: the camera that saw the mask.
        ego_T_camera: its mounting.
        mask: (H, W) drivable pixels.
    """
    message = SceneUpdate()
    entity = message.entities.add(frame_id=EGO, id="drivable")
    set_stamp(entity, stamp_ns)
    patch = road_patch(surface)
    indices = patch_triangles(patch).ravel().tolist()
    entity.triangles.add(color=_color(colours.DRIVABLE, 0.25), indices=indices, points=_points3(patch))
    outline = _outline(surface, camera, ego_T_camera, mask)
    if len(outline):
        entity.lines.add(
            type=LinePrimitive.LINE_LOOP,
            thickness=2.0,
            scale_invariant=True,
            color=_color(colours.DRIVABLE),
            points=_points3(outline),
        )
    return message.SerializeToString()


def lanes_scene(stamp_ns: int, lanes: Lanes) -> bytes:
    """Encode the boundaries on the road, in the ego frame."""
    message = SceneUpdate()
    for boundary in lanes.boundaries:
        entity = message.entities.add(frame_id=EGO, id=f"lane_{boundary.side}")
        set_stamp(entity, stamp_ns)
        if len(boundary.line_ego_m):
            colour, points = _color(colours.BOUNDARY[boundary.status]), _points3(boundary.line_ego_m)
            entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=0.1, color=colour, points=points)
    return message.SerializeToString()


def objects_scene(stamp_ns: int, camera: Camera, ego_T_camera: Float, objects: Objects) -> bytes:
    """Encode kept objects with a known distance as slabs across the central rays of their boxes, in the ego frame.

    An object has a caption here if it has one in the image. All objects share one entity, so each frame replaces the
    previous one.
    """
    message = SceneUpdate()
    entity = message.entities.add(frame_id=EGO, id="objects")
    set_stamp(entity, stamp_ns)
    x, y, z, w = quaternion(ego_T_camera[:3, :3])
    sides_of_image = Quaternion(x=x, y=y, z=z, w=w)
    places = zip(objects.objects, _places(camera, objects.objects), strict=True)
    shown = [(item, place) for item, place in places if item.kept and item.distance_m is not None]
    centres_m, sizes_m = slabs(camera, [item for item, _ in shown])
    positions = transform(ego_T_camera, centres_m).tolist()
    for (item, place), (x, y, z), size_m in zip(shown, positions, sizes_m.tolist(), strict=True):
        colour, _ = _box_style(item)
        width_m, height_m, thick_m = size_m
        entity.cubes.add(
            pose=Pose(position=Vector3(x=x, y=y, z=z), orientation=sides_of_image),
            size=Vector3(x=width_m, y=height_m, z=thick_m),
            color=_color(colour, 0.5),
        )
        if place is not None:
            entity.texts.add(
                pose=Pose(position=Vector3(x=x, y=y, z=z + height_m / 2), orientation=Quaternion(w=1.0)),
                billboard=True,
                font_size=_CAPTION_M,
                color=_color(colour),
                text=caption(item),
            )
    return message.SerializeToString()


def slabs(camera: Camera, objects: Sequence[Object]) -> tuple[Float, Float]:
    """(N, 3) centres and (N, 3) sides, metres in the camera frame, of slabs that cover objects at their distances.

    They are perpendicular to the camera axis, on the rays through the boxes' centres. A slab is thin because one view
    does not show an object's depth.
    """
    boxes = [item.detection.box_px for item in objects]
    low_px = np.array([(box.x_min, box.y_min) for box in boxes]).reshape(-1, 2)
    high_px = np.array([(box.x_max, box.y_max) for box in boxes]).reshape(-1, 2)
    centres = rays(camera, (low_px + high_px - 1) / 2)
    distances_m = np.array([item.distance_m for item in objects], float)
    depths_m = (distances_m / np.linalg.norm(centres, axis=1))[:, None]
    sides_m = (high_px - low_px) / (camera.fx, camera.fy) * depths_m
    return centres * depths_m, np.append(sides_m, np.full_like(depths_m, _SLAB_M), axis=1)


def road_patch(surface: Surface) -> Float:
    """(2 N, 3) ego points on the road ahead, left and right alternating; a plane has only its four corners."""
    near, far, half = _PATCH_M
    ahead = np.linspace(near, far, 2 if surface.height_grid is None else _PATCH_STRIPS + 1)
    x, y = np.repeat(ahead, 2), np.tile((half, -half), len(ahead))
    return np.stack((x, y, height_at(surface, x, y)), axis=-1)


def patch_triangles(patch: Float) -> NDArray[np.int64]:
    """(M, 3) indices of the patch's points that form triangles."""
    strips = np.arange(len(patch) // 2 - 1)[:, None, None]
    corners: NDArray[np.int64] = 2 * strips + np.array([[0, 1, 3], [0, 3, 2]])
    return corners.reshape(-1, 3)


def _outline(surface: Surface, camera: Camera, ego_T_camera: Float, mask: Mask) -> Float:
    """(N, 3) ego points on the outline of the largest drivable region, without those beyond 60 m."""
    top = int(mask.argmax()) // mask.shape[1]  # nothing is set above the first set pixel
    contours, _ = cv2.findContours(
        mask[top:].view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(0, top)
    )
    if not contours:
        return np.empty((0, 3))
    largest = max(contours, key=cv2.contourArea)
    pixels = cv2.approxPolyDP(largest, _OUTLINE_TOLERANCE_PX, closed=True).reshape(-1, 2).astype(float)
    points = ground_points(surface, camera, ego_T_camera, pixels)
    near = np.linalg.norm(np.nan_to_num(points, nan=np.inf), axis=1) < _OUTLINE_MAX_M
    return np.asarray(points[near], float)


def _box_style(item: Object) -> tuple[Colour, float]:
    """Colour and line width; dropped objects have thin lines."""
    return colours.OBJECT[item.verdict], 3.0 if item.kept else 1.0


def caption(item: Object) -> str:
    """Label, distance and time to impact of an object; a dropped object also shows its share of class pixels."""
    parts = [item.detection.label]
    if item.distance_m is not None:
        parts.append(f"{item.distance_m:.1f} m")
    if item.time_to_impact_s is not None:
        parts.append(f"{item.time_to_impact_s:.1f} s")
    if not item.kept and item.class_ratio is not None:
        parts.append(f"{item.class_ratio:.0%}")
    return " ".join(parts)


@lru_cache(1)
def _places(camera: Camera, objects: tuple[Object, ...]) -> tuple[Box | None, ...]:
    """The place of each object's caption, or None; cached because the image and the scene of a frame need it."""
    boxes = [item.detection.box_px for item in objects]
    text_sizes = [viewer_text_size(camera, caption(item)) for item in objects]
    return caption_places((camera.width, camera.height), objects, boxes, text_sizes)


def _corners(box: Box) -> Float:
    x0, y0, x1, y1 = box.x_min, box.y_min, box.x_max - 1, box.y_max - 1
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def _points(
    message: ImageAnnotations, kind: Any, points: Float, colour: Colour, width: float, alpha: float = 1.0
) -> None:
    message.points.add(
        timestamp=message.timestamp,
        type=kind,
        outline_color=_color(colour, alpha),
        thickness=width,
        points=[{"x": x, "y": y} for x, y in points.tolist()],
    )


def _text(message: ImageAnnotations, camera: Camera, position: Iterable[float], text: str, colour: Colour) -> None:
    x, y = position
    width, _ = viewer_text_size(camera, text)
    message.texts.add(
        timestamp=message.timestamp,
        position=Point2(x=max(min(x, camera.width - width), 0.0), y=y),
        text=text,
        font_size=viewer_font_px(camera),
        text_color=_color(colour),
        background_color=_color((0, 0, 0), 0.6),
    )


@cache
def _color(colour: Colour, alpha: float = 1.0) -> Color:
    """A colour message, cached because there are only a few."""
    r, g, b = (value / 255 for value in colour)
    return Color(r=r, g=g, b=b, a=alpha)


def _points3(points: Float) -> list[dict[str, float]]:
    """Points as fields: messages would be copied, which takes twice the time."""
    return [{"x": x, "y": y, "z": z} for x, y, z in points.tolist()]
