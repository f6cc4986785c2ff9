"""CARLA's poses, converted to right-handed ones.

CARLA (Unreal) is left-handed: x forward, y right, z up; rotations are yaw about z (to the right), then pitch (nose up),
then roll (right side down), in degrees, with the matrix of ``carla::geom::Transform::GetMatrix``. Mirroring y turns it
into ROS' x forward, y left, z up: with M = diag(1, -1, 1) the rotation becomes M R M. In angles that is roll, -pitch,
-yaw for Rz(yaw) Ry(pitch) Rx(roll), and y becomes -y in positions.
"""

import csv
from pathlib import Path

import numpy as np
from pydantic import AliasPath, ConfigDict, Field, FiniteFloat, TypeAdapter

from roadperc_stream.core.geometry import EGO_R_OPTICAL, Float, rigid
from roadperc_stream.core.rotations import rotation_from_rpy
from roadperc_stream.errors import DumpError

from .json_files import Document, by_frame, checked, read_json

COLUMNS = ("frame", "x", "y", "z", "roll", "pitch", "yaw")


class CarlaPose(Document):
    """Position in metres and angles in degrees, in CARLA's left-handed convention."""

    model_config = ConfigDict(extra="forbid")

    x: FiniteFloat = 0.0
    y: FiniteFloat = 0.0
    z: FiniteFloat
    roll: FiniteFloat = 0.0
    pitch: FiniteFloat = 0.0
    yaw: FiniteFloat = 0.0


class _Transform(Document):
    """As ``carla.Transform`` prints itself: {"location": {x, y, z}, "rotation": {pitch, yaw, roll}}."""

    x: FiniteFloat = Field(validation_alias=AliasPath("location", "x"))
    y: FiniteFloat = Field(validation_alias=AliasPath("location", "y"))
    z: FiniteFloat = Field(validation_alias=AliasPath("location", "z"))
    roll: FiniteFloat = Field(validation_alias=AliasPath("rotation", "roll"))
    pitch: FiniteFloat = Field(validation_alias=AliasPath("rotation", "pitch"))
    yaw: FiniteFloat = Field(validation_alias=AliasPath("rotation", "yaw"))


_TRANSFORMS = TypeAdapter(dict[str, _Transform])
_ROWS = TypeAdapter(dict[str, CarlaPose])


def right_handed(pose: CarlaPose | _Transform) -> Float:
    """(4, 4) right-handed parent_T_body of a CARLA pose, metres."""
    roll, pitch, yaw = np.deg2rad((pose.roll, -pose.pitch, -pose.yaw))
    return rigid(rotation_from_rpy(roll, pitch, yaw), np.array([pose.x, -pose.y, pose.z]))


def camera_mounting(pose: CarlaPose) -> Float:
    """ego_T_camera, camera frame optical, of a camera mounted at a CARLA pose in the ego frame."""
    return right_handed(pose) @ rigid(EGO_R_OPTICAL, np.zeros(3))


def load_poses(path: Path) -> dict[int, Float]:
    """odom_T_ego by frame number; CARLA's world, mirrored, serves as odom.

    Raises:
        DumpError: the file is neither the JSON nor the table expected, or holds values that are no pose.

    """
    if path.suffix == ".json":
        entries = checked(path, _TRANSFORMS, read_json(path))
        return {number: right_handed(pose) for number, pose in by_frame(path, entries).items()}
    rows = checked(path, _ROWS, _read_table(path))
    return {number: right_handed(pose) for number, pose in by_frame(path, rows).items()}


def _read_table(path: Path) -> dict[str, dict[str, str]]:
    """Rows by frame of a table with a header line, separated by commas or blanks."""
    try:
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise DumpError(f"{path}: {error}") from error
    split = list(csv.reader(lines)) if lines and "," in lines[0] else [line.split() for line in lines]
    rows = [[cell.strip() for cell in row] for row in split]
    header = [name.lower() for name in rows[0]] if rows else []
    if not set(COLUMNS) <= set(header):
        raise DumpError(f"{path}: expected a header with {','.join(COLUMNS)}, got {','.join(header) or 'nothing'}")
    table: dict[str, dict[str, str]] = {}
    for line, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise DumpError(f"{path}: row {line}: expected {len(header)} values, got {len(row)}")
        entry = dict(zip(header, row, strict=True))
        if table.setdefault(entry["frame"], {}):
            raise DumpError(f"{path}: row {line}: frame {entry['frame']} stands twice")
        table[entry["frame"]] = {name: entry[name] for name in COLUMNS[1:]}
    return table
