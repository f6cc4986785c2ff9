"""Draws the road, the occupancy map and the trajectory in 3D; numbers, states and log lines over time."""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any, Final

import numpy as np
import rerun as rr

from roadperc_stream.geometry import mounting
from roadperc_stream.model import EGO, PointCloud, Surface, Transform
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.annotations import patch_triangles, road_patch
from roadperc_stream.schemas.protobuf import reason_in, require_finite
from roadperc_stream.view.rerun.tree import Entry, SceneState, edge_entry, known_as, new_edges, of_odometry

_ROAD: Final = (*colours.DRIVABLE, 70)
_TRAJECTORY: Final = (255, 170, 0)
_BELOW_THE_ROAD_M: Final = -0.05
"""The map is slightly below the road; in the same plane they would flicker."""


def transforms(entity: str, role: str, payload: tuple[Transform, ...], state: SceneState) -> Iterator[Entry]:
    """Draw the changed edges of the tree, or the odometry pose of the car."""
    if role == "result":
        yield from (edge_entry(entity, edge) for edge in payload if of_odometry(edge))
    else:
        state.latch(role, payload)
        yield from new_edges(state)


def pose(entity: str, role: str, payload: Transform, state: SceneState) -> Iterator[Entry]:
    """Draw the pose of the car as an arrow of 2 m."""
    matrix = payload.parent_T_child
    arrow = rr.Arrows3D(origins=[matrix[:3, 3]], vectors=[2.0 * matrix[:3, 0]], colors=[_TRAJECTORY], radii=[0.1])
    in_the_tree = role != "result" and state.knows(payload.parent)
    yield Entry(entity, arrow, known_as(payload.parent) if in_the_tree else payload.parent)


def road(entity: str, role: str, payload: Surface, state: SceneState) -> Iterator[Entry]:
    """Draw a patch of the road; the first one also gives the assumed mounting of a camera without transforms."""
    if role.startswith("truth"):
        return  # the true road would cover the estimated one
    if state.assumed_mounting is None:
        plane = payload.ego_plane
        height_above_ego_m = (payload.camera_height_m - plane.offset_m) / plane.normal[2]
        state.assumed_mounting = mounting(z=float(height_above_ego_m))
        yield from new_edges(state)
    patch = road_patch(payload)
    mesh = rr.Mesh3D(vertex_positions=patch, triangle_indices=patch_triangles(patch), albedo_factor=_ROAD)
    yield Entry(entity, mesh, EGO)


def points(entity: str, _role: str, payload: PointCloud, _world: SceneState) -> Iterator[Entry]:
    """Draw lidar points."""
    cloud = rr.Points3D(payload.points_m, radii=rr.Radius.ui_points(1.5))
    yield Entry(entity, cloud, known_as(payload.frame_id))


def outlines(entity: str, message: Any) -> Iterator[Entry]:
    """Draw the lines of a foxglove.SceneUpdate; the patch of the road comes from the surface."""
    for part in message.entities:
        points_m = [[(p.x, p.y, p.z) for p in line.points] for line in part.lines]
        strips = [line + line[:1] for line in points_m]
        lines = rr.LineStrips3D(strips, radii=rr.Radius.ui_points(2.0), colors=[colours.DRIVABLE] * len(strips))
        yield Entry(f"{entity}/{part.id}", lines, part.frame_id)


def occupancy(entity: str, message: Any) -> Iterator[Entry]:
    """Draw the map of a nav_msgs/msg/OccupancyGrid."""
    info = message.info
    grid = rr.GridMap(
        data=np.ascontiguousarray(message.data).tobytes(),
        format=rr.components.ImageFormat(width=info.width, height=info.height, color_model="L", channel_datatype="U8"),
        cell_size=info.resolution,
        translation=(info.origin.position.x, info.origin.position.y, info.origin.position.z + _BELOW_THE_ROAD_M),
        colormap="rvizmap",
        opacity=0.6,
    )
    yield Entry(entity, grid, message.header.frame_id)


def trajectory(entity: str, message: Any) -> Iterator[Entry]:
    """Draw the trajectory of a foxglove.PosesInFrame."""
    trajectory_m = [(pose.position.x, pose.position.y, pose.position.z) for pose in message.poses]
    require_finite("trajectory", *chain.from_iterable(trajectory_m))
    yield Entry(entity, rr.LineStrips3D([trajectory_m], colors=[_TRAJECTORY], radii=0.08), message.frame_id)


STATES: Final = ("_status", "_source", "_class")
"""Suffixes of metrics that are texts."""
MISSING: Final = "missing"
_IDENTIFIERS: Final = ("frame", "stamp_ns")
_LEVELS: Final = ("INFO", "DEBUG", "INFO", "WARN", "ERROR", "CRITICAL")
"""Rerun's names for the levels of foxglove.Log; level 0 is unknown."""


def metrics(entity: str, message: Any, state: SceneState) -> Iterator[Entry]:
    """Draw the numbers of a roadperc.FrameMetrics as curves, its texts as states, and new reasons as log lines."""
    for field, value in message.ListFields():
        if isinstance(value, int | float) and field.name not in _IDENTIFIERS:
            yield Entry(f"{entity}/{field.name}", rr.Scalars(float(value)))
    for name, text in _texts(message).items():
        if text or state.texts.get(name):  # an empty text ends the previous state
            yield Entry(f"{entity}/{name}", rr.StateChange(state=text))
        state.texts[name] = text
    reasons = "; ".join(str(reason_in(reason)) for reason in message.reasons)
    if reasons != state.texts.get("reasons", ""):
        line = rr.TextLog(reasons, level="WARN") if reasons else rr.TextLog("nothing is missing now", level="INFO")
        yield Entry(f"{entity}/reasons", line)
    state.texts["reasons"] = reasons


def _texts(message: Any) -> dict[str, str]:
    """The states of a frame, empty if unknown, and its missing roles as one text."""
    states = (field.name for field in message.DESCRIPTOR.fields if field.name.endswith(STATES))
    return {name: getattr(message, name) for name in states} | {MISSING: ", ".join(message.missing)}


def times(entity: str, times_ms: Mapping[str, float]) -> Iterator[Entry]:
    """Draw the milliseconds of the stages that ran."""
    for column, value in times_ms.items():
        yield Entry(f"{entity}/{column}", rr.Scalars(value))


def log_line(entity: str, message: Any) -> Iterator[Entry]:
    """Draw a foxglove.Log as a log line."""
    yield Entry(entity, rr.TextLog(message.message, level=_LEVELS[message.level]))
