"""``truth.json``: what a renderer knows of lanes, surface and objects, frame by frame."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveInt, TypeAdapter

from roadperc_stream.core.datatypes import SIDES, Boundary, Detection, HeightGrid, Lanes, Object, Objects, Side, Surface
from roadperc_stream.core.datatypes.results import LaneChange
from roadperc_stream.core.geometry import Plane
from roadperc_stream.errors import DumpError

from .detection_files import checked_box
from .json_files import Document, Numbers3, Numbers4, by_frame, checked, read_json


class _Boundary(Document):
    offset_m: float
    heading: float
    curvature_per_m: float
    inside: str = ""
    outside: str = ""
    line_ego_m: list[Numbers3] = Field(default_factory=list)


class _Lanes(Document):
    left: _Boundary | None = None
    right: _Boundary | None = None
    lane_change: LaneChange | None = None
    lane_changes: Annotated[int, Field(ge=0)] | None = None


class _HeightGrid(Document):
    x_min_m: float
    y_min_m: float
    step_m: Annotated[float, Field(gt=0)]
    columns: PositiveInt
    rows: PositiveInt
    z_m: list[float]


class _Surface(Document):
    normal: Numbers3
    camera_height_m: Annotated[float, Field(gt=0)]
    pitch: float
    roll: float
    a: float
    b: float
    d: float
    height_grid: _HeightGrid | None = None


class _Object(Document):
    id: str | int
    label: str
    box_px: Numbers4
    distance_m: float | None = None
    closing_speed_mps: float | None = None
    time_to_impact_s: float | None = None
    lateral_m: float | None = None
    in_path: bool | None = None


class _Truth(Document):
    lanes: dict[str, _Lanes] = Field(default_factory=dict)
    surface: dict[str, _Surface] = Field(default_factory=dict)
    objects: dict[str, list[_Object]] = Field(default_factory=dict)


@dataclass(frozen=True)
class TruthTables:
    """Truth by frame number."""

    lanes: Mapping[int, Lanes]
    surfaces: Mapping[int, Surface]
    objects: Mapping[int, Objects]


NO_TRUTH = TruthTables({}, {}, {})


def load_truth(path: Path, surface_frame_id: str) -> TruthTables:
    """Read ``truth.json``; the surface is in the frame of the camera the depth belongs to.

    Raises:
        DumpError: names file, key and fault.

    """
    truth = checked(path, TypeAdapter(_Truth), read_json(path))
    return TruthTables(
        {n: _lanes(lanes) for n, lanes in by_frame(path, truth.lanes).items()},
        {n: _surface(path, n, s, surface_frame_id) for n, s in by_frame(path, truth.surface).items()},
        {n: _objects(path, n, objects) for n, objects in by_frame(path, truth.objects).items()},
    )


def _lanes(lanes: _Lanes) -> Lanes:
    sides: dict[Side, _Boundary | None] = {"left": lanes.left, "right": lanes.right}
    return Lanes(
        tuple(_boundary(side, entry) for side in SIDES if (entry := sides[side]) is not None),
        lane_change=lanes.lane_change,
        lane_changes=lanes.lane_changes,
    )


def _boundary(side: Side, entry: _Boundary) -> Boundary:
    return Boundary(
        side,
        "measured",
        offset_m=entry.offset_m,
        heading=entry.heading,
        curvature_per_m=entry.curvature_per_m,
        inside=entry.inside,
        outside=entry.outside,
        line_ego_m=np.array(entry.line_ego_m, np.float64).reshape(-1, 3),
    )


def _surface(path: Path, number: int, entry: _Surface, frame_id: str) -> Surface:
    if not np.linalg.norm(entry.normal) > 0:
        raise DumpError(f"{path}: surface of frame {number}: normal is zero")
    return Surface(
        source="truth",
        frame_id=frame_id,
        plane=Plane.of(np.array(entry.normal) / np.linalg.norm(entry.normal), entry.camera_height_m),
        ego_plane=Plane.of(np.array([entry.a, entry.b, 1.0]), -entry.d),
        camera_height_m=entry.camera_height_m,
        pitch=entry.pitch,
        roll=entry.roll,
        height_grid=_grid(path, number, entry.height_grid),
    )


def _grid(path: Path, number: int, grid: _HeightGrid | None) -> HeightGrid | None:
    if grid is None:
        return None
    if len(grid.z_m) != grid.rows * grid.columns:
        size = f"{grid.rows} rows x {grid.columns} columns"
        raise DumpError(f"{path}: height_grid of frame {number}: {len(grid.z_m)} heights for {size}")
    heights = np.array(grid.z_m, np.float32).reshape(grid.rows, grid.columns)
    return HeightGrid(grid.x_min_m, grid.y_min_m, grid.step_m, heights)


def _objects(path: Path, number: int, entries: list[_Object]) -> Objects:
    return Objects(tuple(_object(f"{path}: objects of frame {number}", entry) for entry in entries))


def _object(where: str, entry: _Object) -> Object:
    return Object(
        Detection(entry.label, checked_box(where, *entry.box_px), 1.0, str(entry.id)),
        kept=True,
        distance_m=entry.distance_m,
        closing_speed_mps=entry.closing_speed_mps,
        time_to_impact_s=entry.time_to_impact_s,
        track_id=str(entry.id),
        lateral_m=entry.lateral_m,
        in_path=entry.in_path,
    )
