"""The road, the map around the car and its trajectory in space; numbers and words over time."""

from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any, Final

import numpy as np
import rerun as rr

from roadperc_stream.geometry import level_mounting
from roadperc_stream.model import EGO, PointCloud, Surface, Transform
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.annotations import patch_triangles, road_patch
from roadperc_stream.schemas.protobuf import require_finite
from roadperc_stream.view.rerun.tree import Entry, SceneState, edge_entry, known_as, new_edges, of_odometry

_ROAD: Final = (*colours.DRIVABLE, 70)
_TRAJECTORY: Final = (255, 170, 0)
_BELOW_THE_ROAD_M: Final = -0.05
"""The map lies a little lower than the road's plane: in one plane they would flicker."""


def transforms(entity: str, role: str, payload: tuple[Transform, ...], world: SceneState) -> Iterator[Entry]:
    """The changed edges of the tree, or the odometry pose of the car."""
    if role == "result":
        yield from (edge_entry(entity, edge) for edge in payload if of_odometry(edge))
    else:
        world.latch(role, payload)
        yield from new_edges(world)


def pose(entity: str, role: str, payload: Transform, world: SceneState) -> Iterator[Entry]:
    """The pose of the car: an arrow of 2 m."""
    matrix = payload.parent_T_child
    arrow = rr.Arrows3D(origins=[matrix[:3, 3]], vectors=[2.0 * matrix[:3, 0]], colors=[_TRAJECTORY], radii=[0.1])
    in_the_tree = role != "result" and world.knows(payload.parent)
    yield Entry(entity, arrow, known_as(payload.parent) if in_the_tree else payload.parent)


def road(entity: str, role: str, payload: Surface, world: SceneState) -> Iterator[Entry]:
    """A patch of the road ahead; and from the first one the mounting of a camera that the log does not place."""
    if role.startswith("truth"):
        return  # it would cover the road that was found
    if world.assumed_mounting is None:
        world.assumed_mounting = level_mounting(_assumed_height_m(payload))
        yield from new_edges(world)
    patch = road_patch(payload)
    mesh = rr.Mesh3D(vertex_positions=patch, triangle_indices=patch_triangles(patch), albedo_factor=_ROAD)
    yield Entry(entity, mesh, EGO)


def _assumed_height_m(surface: Surface) -> float:
    """Height of a level camera above the ego origin: what is between its height above the road and the road's."""
    return float((surface.camera_height_m - surface.ego_plane.offset_m) / surface.ego_plane.normal[2])


def points(entity: str, _role: str, payload: PointCloud, _world: SceneState) -> Iterator[Entry]:
    """A lidar's points."""
    cloud = rr.Points3D(payload.points_m, radii=rr.Radius.ui_points(1.5))
    yield Entry(entity, cloud, known_as(payload.frame_id))


def outlines(entity: str, message: Any) -> Iterator[Entry]:
    """Lines of a foxglove.SceneUpdate; the road's own patch is drawn from the surface."""
    for part in message.entities:
        strips = [_closed([(p.x, p.y, p.z) for p in line.points]) for line in part.lines]
        lines = rr.LineStrips3D(strips, radii=rr.Radius.ui_points(2.0), colors=[colours.DRIVABLE] * len(strips))
        yield Entry(f"{entity}/{part.id}", lines, part.frame_id)


def _closed(strip: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    return strip + strip[:1]


def occupancy(entity: str, message: Any) -> Iterator[Entry]:
    """The map of a nav_msgs/msg/OccupancyGrid."""
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
    """The trajectory in a foxglove.PosesInFrame."""
    trajectory_m = [(pose.position.x, pose.position.y, pose.position.z) for pose in message.poses]
    require_finite("trajectory", *chain.from_iterable(trajectory_m))
    yield Entry(entity, rr.LineStrips3D([trajectory_m], colors=[_TRAJECTORY], radii=0.08), message.frame_id)


STATES: Final = ("_status", "_source", "_class")
"""How the metrics end that are words."""
MISSING: Final = "missing"
_IDENTIFIERS: Final = ("frame", "stamp_ns")
_LEVELS: Final = ("INFO", "DEBUG", "INFO", "WARN", "ERROR", "CRITICAL")
"""Rerun's words for foxglove.Log's levels, whose first is unknown."""


def metrics(entity: str, message: Any, world: SceneState) -> Iterator[Entry]:
    """Every number of a roadperc.FrameMetrics as a curve, its words as states, and the reasons for what is unknown."""
    for field, value in message.ListFields():
        if isinstance(value, int | float) and field.name not in _IDENTIFIERS:
            yield Entry(f"{entity}/{field.name}", rr.Scalars(float(value)))
    for name, word in _words(message).items():
        if word or world.words.get(name):  # an empty one ends the state before
            yield Entry(f"{entity}/{name}", rr.StateChange(state=word))
        world.words[name] = word
    yield from _reasons(entity, "; ".join(message.reasons), world)


def _words(message: Any) -> dict[str, str]:
    """The words of a frame, empty where it has none; roles without a message in one."""
    states = (field.name for field in message.DESCRIPTOR.fields if field.name.endswith(STATES))
    return {name: getattr(message, name) for name in states} | {MISSING: ", ".join(message.missing)}


def _reasons(entity: str, reasons: str, world: SceneState) -> Iterator[Entry]:
    """A line where they change: it holds until the next one."""
    if reasons != world.words.get("reasons", ""):
        line = rr.TextLog(reasons, level="WARN") if reasons else rr.TextLog("nothing is missing now", level="INFO")
        yield Entry(f"{entity}/reasons", line)
    world.words["reasons"] = reasons


def times(entity: str, times_ms: Mapping[str, float]) -> Iterator[Entry]:
    """Milliseconds of the stages that ran."""
    for column, value in times_ms.items():
        yield Entry(f"{entity}/{column}", rr.Scalars(value))


def log_line(entity: str, message: Any) -> Iterator[Entry]:
    """A line of a foxglove.Log."""
    yield Entry(entity, rr.TextLog(message.message, level=_LEVELS[message.level]))
