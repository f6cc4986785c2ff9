"""Ground truth of a dump by frame: poses, and lanes, surface and objects of ``truth.json``.

Raises everywhere:
    DumpError: the file is wrong; the message names file, key or row, and error.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AliasPath, ConfigDict, Field, PositiveInt, TypeAdapter

from roadperc_stream.config.calibration import CarlaPose, Number, Numbers3, Numbers4
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, Plane
from roadperc_stream.input.calibrations import right_handed
from roadperc_stream.model import Boundary, Detection, HeightGrid, Lanes, Object, Objects, Side, Surface
from roadperc_stream.model.results import LaneChange
from roadperc_stream.system.text import in_brief

from .detection_files import checked_box
from .documents import Document, Id, Listed, by_frame, checked, read_json, read_lines, read_rows

COLUMNS = ("frame", "x", "y", "z", "roll", "pitch", "yaw")


class _Transform(CarlaPose):
    """A pose in the format of ``carla.Transform``: {"location": {x, y, z}, "rotation": {pitch, yaw, roll}}."""

    model_config = ConfigDict(extra="ignore")

    x: Number = Field(validation_alias=AliasPath("location", "x"))
    y: Number = Field(validation_alias=AliasPath("location", "y"))
    z: Number = Field(validation_alias=AliasPath("location", "z"))
    roll: Number = Field(validation_alias=AliasPath("rotation", "roll"))
    pitch: Number = Field(validation_alias=AliasPath("rotation", "pitch"))
    yaw: Number = Field(validation_alias=AliasPath("rotation", "yaw"))


def load_poses(path: Path) -> dict[int, Float]:
    """Return odom_T_ego by frame number; odom is CARLA's world, mirrored."""
    if path.suffix == ".json":
        poses: Mapping[str, CarlaPose | _Transform] = checked(path, TypeAdapter(dict[str, _Transform]), read_json(path))
    else:
        poses = checked(path, TypeAdapter(dict[str, CarlaPose]), _read_table(path))
    return {number: right_handed(pose) for number, pose in by_frame(path, poses).items()}


def _read_table(path: Path) -> dict[str, dict[str, str]]:
    """Return the rows by frame of a table with a header line, separated by commas or spaces."""
    lines = [line for line in read_lines(path) if line.strip()]
    split = list(read_rows(path, lines)) if lines and "," in lines[0] else [line.split() for line in lines]
    rows = [[cell.strip() for cell in row] for row in split]
    header = [name.lower() for name in rows[0]] if rows else []
    if not set(COLUMNS) <= set(header):
        raise DumpError(f"{path}: expected a header with {','.join(COLUMNS)}, got {in_brief(','.join(header))}")
    table: dict[str, dict[str, str]] = {}
    for line, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise DumpError(f"{path}: row {line}: expected {len(header)} values, got {len(row)}")
        entry = dict(zip(header, row, strict=True))
        if table.setdefault(entry["frame"], {}):
            raise DumpError(f"{path}: row {line}: frame {in_brief(entry['frame'])} appears twice")
        table[entry["frame"]] = {name: entry[name] for name in COLUMNS[1:]}
    return table


class _Boundary(Document):
    offset_m: Number
    heading: Number
    curvature_per_m: Number
    inside: str = ""
    outside: str = ""
    line_ego_m: Listed[Numbers3] = Field(default_factory=list)


class _Lanes(Document):
    left: _Boundary | None = None
    right: _Boundary | None = None
    lane_change: LaneChange | None = None
    lane_changes: Annotated[int, Field(ge=0)] | None = None


class _HeightGrid(Document):
    x_min_m: Number
    y_min_m: Number
    step_m: Annotated[Number, Field(gt=0)]
    columns: PositiveInt
    rows: PositiveInt
    z_m: Listed[Number]


class _Surface(Document):
    normal: Numbers3
    camera_height_m: Annotated[Number, Field(gt=0)]
    pitch: Number
    roll: Number
    a: Number
    b: Number
    d: Number
    height_grid: _HeightGrid | None = None


class _Object(Document):
    id: Id
    label: str
    box_px: Numbers4
    distance_m: Number | None = None
    closing_speed_mps: Number | None = None
    time_to_impact_s: float | None = None
    lateral_m: Number | None = None
    in_path: bool | None = None


class _Truth(Document):
    lanes: Mapping[str, _Lanes] = {}
    surface: Mapping[str, _Surface] = {}
    objects: Mapping[str, Listed[_Object]] = {}


@dataclass(frozen=True)
class TruthTables:
    """Ground truth by frame number."""

    lanes: Mapping[int, Lanes] = field(default_factory=dict)
    surfaces: Mapping[int, Surface] = field(default_factory=dict)
    objects: Mapping[int, Objects] = field(default_factory=dict)


def load_truth(path: Path, surface_frame_id: str) -> TruthTables:
    """Read ``truth.json``; the surface is in ``surface_frame_id``, the frame of the depth camera."""
    truth = checked(path, TypeAdapter(_Truth), read_json(path))
    return TruthTables(
        lanes={n: _lanes(lanes) for n, lanes in by_frame(path, truth.lanes).items()},
        surfaces={n: _surface(path, n, s, surface_frame_id) for n, s in by_frame(path, truth.surface).items()},
        objects={
            n: Objects(tuple(_object(f"{path}: objects of frame {n}", entry) for entry in objects))
            for n, objects in by_frame(path, truth.objects).items()
        },
    )


def _lanes(lanes: _Lanes) -> Lanes:
    sides: dict[Side, _Boundary | None] = {"left": lanes.left, "right": lanes.right}
    return Lanes(
        tuple(_boundary(side, entry) for side, entry in sides.items() if entry is not None),
        lane_change=lanes.lane_change,
        lane_changes=lanes.lane_changes,
    )


def _boundary(side: Side, entry: _Boundary) -> Boundary:
    line_ego_m = np.array(entry.line_ego_m, np.float64).reshape(-1, 3)
    return Boundary(side, "measured", **entry.model_dump(exclude={"line_ego_m"}), line_ego_m=line_ego_m)


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


def _object(where: str, entry: _Object) -> Object:
    detection = Detection(entry.label, checked_box(where, *entry.box_px), 1.0, str(entry.id))
    known = entry.model_dump(exclude={"id", "label", "box_px"})
    return Object(detection, kept=True, track_id=str(entry.id), **known)
