"""Bench2Drive: the front camera with depth, tags and instances, the lidar, and the boxes and poses of ``anno``.

Matrices are CARLA's, left-handed. Theta is CARLA's compass: 0 is north = (0, -1, 0). ``extent`` is half the size.
The poses of parked vehicles are wrong; ``center``, ``extent`` and ``world2vehicle`` are right.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter

from roadperc_stream.config.calibration import CarlaPose, Matrix3, Number, Numbers3
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import EGO_R_OPTICAL, Float, inverse, rigid
from roadperc_stream.input.calibrations import LIDAR, right_handed
from roadperc_stream.model.tag_tables import classes_of_label

from ..carla_dump.frame_stamps import stamps_of_rate
from ..carla_dump.json_files import Document, Id, Listed, checked
from ..carla_dump.layout import sensor_in
from ..carla_dump.survey import surveyed
from .boxes import LabelledBox, objects_of_boxes
from .carla_files import Halves, Matrix4, folders_that, laz_sensor, numbered, read_document, right_handed_matrix
from .drive import ConvertOptions, Drive, choose_sequence
from .front_rig import front_rig

_RATE_HZ: Final = 10.0
_CARLA: Final = "0.9.15"
_FRONT: Final = {
    "image": "rgb_front",
    "depth": "depth_front",
    "segmentation": "semantic_front",
    "instances": "instance_front",
}


class _Camera(Document):
    intrinsic: Matrix3
    cam2ego: Matrix4


class _Sensors(Document):
    CAM_FRONT: _Camera


class _Annotation(Document):
    theta: Number | None = None
    sensors: _Sensors
    bounding_boxes: Listed[dict[str, Any]]


class _Ego(Document):
    world2ego: Matrix4 | None = None
    location: Numbers3


class _Actor(Document):
    id: Id = ""
    base_type: str | None = None
    center: Numbers3
    extent: Halves
    world2vehicle: Matrix4 | None = None
    world2ped: Matrix4 | None = None


def detect(folder: Path) -> bool:
    """Return True if the folder is a clip with annotations and a front camera, or holds some."""
    return bool(folders_that(_is_clip, folder))


def read(folder: Path, options: ConvertOptions) -> Drive:
    """Read one clip.

    Raises:
        DumpError: the folder holds no or several clips, or a file is wrong; the message names file and key.
    """
    options.require_only(folder, "--sequence", "--rate", "--allow-lossy-tags")
    name, clip = choose_sequence(folder, folders_that(_is_clip, folder), options.sequence)
    notes: list[str] = []
    camera = clip / "camera"
    sensors = {role: sensor_in(camera / n, role) for role, n in _FRONT.items() if (camera / n).is_dir()}
    others = sorted(path.name for path in camera.iterdir() if path.name not in _FRONT.values())
    notes += [f"camera/ {', '.join(others)} are left out: rgb_front is the front camera"] if others else []
    notes += ["radar/ is left out"] if (clip / "radar").is_dir() else []
    surveys = surveyed(sensors | laz_sensor(clip, set(sensors["image"].files), notes))
    annotations = numbered(clip / "anno", "*.json.gz")
    poses: dict[int, Float] = {}
    boxes: dict[int, list[LabelledBox]] = {}
    front: _Camera | None = None
    for number, path in annotations.items():
        found = checked(path, TypeAdapter(_Annotation), read_document(path))
        front = front or found.sensors.CAM_FRONT
        if (world_T_ego := _ego_pose(path, found)) is not None:
            poses[number], boxes[number] = world_T_ego, list(_boxes(path, found, inverse(world_T_ego)))
    if front is None:
        raise DumpError(f"{clip / 'anno'}: expected annotations such as 00000.json.gz, found none")
    rig = front_rig(
        f"{next(iter(annotations.values()))}: sensors.CAM_FRONT.intrinsic",
        surveys["image"],
        np.array(front.intrinsic),
        "corner",
        (
            right_handed_matrix(f"{clip}: cam2ego of CAM_FRONT", front.cam2ego) @ rigid(EGO_R_OPTICAL, np.zeros(3)),
            np.eye(4) if LIDAR in surveys else None,
        ),
    )
    rate_hz = options.rate_hz or _RATE_HZ
    return Drive(
        folder=folder,
        title=f"Bench2Drive, {name}",
        surveys=surveys,
        stamps_ns=stamps_of_rate(list(surveys["image"].sensor.files), rate_hz),
        timing=f"{rate_hz:g} Hz by frame number",
        rig=rig,
        poses=poses,
        truth=objects_of_boxes(rig, boxes),
        tag_table=_CARLA,
        grey_depth="linear grey to 255 m",
        pixel_origin="the first pixel's corner, as CARLA has it",
        notes=tuple(notes),
    )


def _is_clip(folder: Path) -> bool:
    return (folder / "anno").is_dir() and (folder / "camera" / _FRONT["image"]).is_dir()


def _ego_pose(path: Path, found: _Annotation) -> Float | None:
    """Return (4, 4) world_T_ego, from the compass without ``world2ego``; None without both."""
    row = next((row for row in found.bounding_boxes if row.get("class") == "ego_vehicle" or "world2ego" in row), None)
    if row is None:
        return None
    ego = checked(path, TypeAdapter(_Ego), row)
    if ego.world2ego is not None:
        return inverse(right_handed_matrix(f"{path}: world2ego", ego.world2ego))
    if found.theta is None:
        return None
    x, y, z = ego.location
    return right_handed(CarlaPose(x=x, y=y, z=z, yaw=float(np.rad2deg(found.theta)) - 90.0))


def _boxes(path: Path, found: _Annotation, ego_T_world: Float) -> Iterator[LabelledBox]:
    """Yield the boxes of vehicles and pedestrians that the lidar hits."""
    for row in found.bounding_boxes:
        if not {"world2vehicle", "world2ped"} & set(row) or row.get("num_points") == 0:
            continue
        actor = checked(path, TypeAdapter(_Actor), row)
        matrix = actor.world2vehicle or actor.world2ped
        if matrix is not None:
            x, y, z = actor.center
            length_m, width_m, height_m = (2 * half for half in actor.extent)
            world_R_box = inverse(right_handed_matrix(f"{path}: {actor.id}", matrix))[:3, :3]
            world_T_box = rigid(world_R_box, np.array([x, -y, z]))
            kind = actor.base_type or ""
            label = "pedestrian" if actor.world2ped else (kind if classes_of_label(kind) else "vehicle")
            yield LabelledBox(label, ego_T_world @ world_T_box, (length_m, width_m, height_m), str(actor.id))
