"""The contents of the messages of roadperc.proto: detections, surface, lanes and objects."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from roadperc_stream import model
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Float, Plane
from roadperc_stream.input.decoding.payload import Contents, Context, require_count
from roadperc_stream.model.results import BoundaryStatus, LaneChange, ObjectStatus
from roadperc_stream.schemas.protobuf import optional, reason_in, require_finite
from roadperc_stream.schemas.roadperc_pb2 import Detections as DetectionsProto
from roadperc_stream.schemas.roadperc_pb2 import Lanes as LanesProto
from roadperc_stream.schemas.roadperc_pb2 import Objects as ObjectsProto
from roadperc_stream.schemas.roadperc_pb2 import Surface as SurfaceProto
from roadperc_stream.schemas.roles import Kind

_LANE_CHANGE_OF: Final[Mapping[str, LaneChange]] = {"none": "none", "left": "left", "right": "right"}
_SIDE_OF: Final[Mapping[int, model.Side]] = {1: "left", 2: "right"}
_BOUNDARY_STATUS_OF: Final[Mapping[int, BoundaryStatus]] = {1: "measured", 2: "held", 3: "lost"}
_OBJECT_STATUS_OF: Final[Mapping[int, ObjectStatus]] = {1: "measured", 2: "tracked", 3: "lost"}
"""A truth without a status counts as measured."""
_FEWEST: Final = 2
"""Least heights along each side of a grid; interpolation needs two."""


def _detections(message: Any, context: Context) -> tuple[model.Detection, ...]:
    """roadperc.Detections."""
    require_count("detections", len(message.detections), context.limits)
    return tuple(map(_detection, message.detections))


def _detection(message: Any) -> model.Detection:
    """One detection of a roadperc.Detections or roadperc.Objects."""
    box = model.Box(message.box_px.x_min, message.box_px.y_min, message.box_px.x_max, message.box_px.y_max)
    require_finite(f"detection {message.label!r}", box.x_min, box.y_min, box.x_max, box.y_max, message.score)
    return model.Detection(message.label, box, float(message.score), message.id)


def _surface(message: Any, _: Context) -> model.Surface:
    """roadperc.Surface of a truth."""
    normal = np.array([message.normal.x, message.normal.y, message.normal.z])
    require_finite("surface", *normal, message.camera_height_m, message.a, message.b, message.d)
    if not np.linalg.norm(normal) > 0:
        raise DecodeError("surface without a normal")
    return model.Surface(
        source="truth",
        frame_id=message.frame_id,
        plane=Plane.of(normal, message.camera_height_m),
        ego_plane=Plane.of(np.array([message.a, message.b, 1.0]), -message.d),
        camera_height_m=message.camera_height_m,
        pitch=message.pitch,
        roll=message.roll,
        inlier_ratio=optional(message, "inlier_ratio"),
        height_grid=_height_grid(message.height_grid) if message.HasField("height_grid") else None,
    )


def _height_grid(grid: Any) -> model.HeightGrid:
    heights = np.array(grid.z_m, np.float32)
    if grid.rows < _FEWEST or grid.columns < _FEWEST or heights.size != grid.rows * grid.columns:
        size = f"{grid.rows} rows of {grid.columns}, {heights.size} heights"
        raise DecodeError(f"height grid: {size}: expected rows times columns, {_FEWEST} or more of each")
    require_finite("height grid", grid.x_min_m, grid.y_min_m, grid.step_m, heights.min(), heights.max())
    if not grid.step_m > 0:
        raise DecodeError(f"height grid: in steps of {grid.step_m:g} m: expected positive steps")
    return model.HeightGrid(grid.x_min_m, grid.y_min_m, grid.step_m, heights.reshape(grid.rows, grid.columns))


def _lanes(message: Any, _: Context) -> model.Lanes:
    """roadperc.Lanes of a truth or of a replay; boundaries of an unknown side are left out."""
    return model.Lanes(
        tuple(_boundary(b) for b in message.boundaries if b.side in _SIDE_OF),
        lane_change=_LANE_CHANGE_OF.get(message.lane_change),
        lane_changes=optional(message, "lane_changes"),
    )


def _boundary(message: Any) -> model.Boundary:
    line_ego_m, line_px = _points(message.line_ego_m, "xyz"), _points(message.line_px, "xy")
    numbers = {name: optional(message, name) for name in ("offset_m", "heading", "curvature_per_m", "raw_offset_m")}
    require_finite("boundary", *numbers.values(), *message.covariance, *line_ego_m.ravel(), *line_px.ravel())
    return model.Boundary(
        side=_SIDE_OF[message.side],
        status=_BOUNDARY_STATUS_OF.get(message.status, "measured"),
        raw_px=_line(message, "raw_px"),
        smoothed_px=_line(message, "smoothed_px"),
        **numbers,
        covariance=tuple(message.covariance),
        inside=message.inside,
        outside=message.outside,
        line_ego_m=line_ego_m,
        line_px=line_px,
        reason=reason_in(message.reason) if message.HasField("reason") else None,
    )


def _points(points: Any, axes: str) -> Float:
    """(N, len(axes)) coordinates."""
    return np.array([[getattr(p, axis) for axis in axes] for p in points], float).reshape(-1, len(axes))


def _line(message: Any, name: str) -> model.Line | None:
    line = optional(message, name)
    if line is None:
        return None
    require_finite(name, line.x1, line.y1, line.x2, line.y2)
    return line.x1, line.y1, line.x2, line.y2


_OPTIONAL_NUMBERS: Final = (
    "class_ratio",
    "distance_m",
    "distance_std_m",
    "closing_speed_mps",
    "closing_speed_std_mps",
    "time_to_impact_s",
    "time_to_impact_std_s",
    "lateral_m",
)


def _objects(message: Any, context: Context) -> model.Objects:
    """roadperc.Objects of a truth or of a replay."""
    require_count("detections", len(message.objects), context.limits)
    return model.Objects(tuple(map(_object, message.objects)))


def _object(message: Any) -> model.Object:
    numbers = {name: optional(message, name) for name in _OPTIONAL_NUMBERS}
    require_finite("objects", *numbers.values())
    return model.Object(
        detection=_detection(message.detection),
        kept=message.kept,
        beyond_range=message.beyond_range,
        status=_OBJECT_STATUS_OF.get(message.status, "measured"),
        track_id=message.track_id,
        in_path=optional(message, "in_path"),
        cut_in=optional(message, "cut_in"),
        distance_source="ground" if message.distance_source == "ground" else "depth",
        **numbers,
    )


CONTENTS: Final[Mapping[tuple[Kind, Any], Contents]] = {
    ("detections", DetectionsProto): _detections,
    ("surface", SurfaceProto): _surface,
    ("lanes", LanesProto): _lanes,
    ("objects", ObjectsProto): _objects,
}
"""By kind and message type."""
