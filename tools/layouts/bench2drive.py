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

from ..readers.documents import Document, Id, Listed, checked
from ..readers.frame_stamps import stamps_of_rate
from ..readers.sensor_folders import sensor_in, with_headers
from ..rig import front_rig
from .boxes import LabelledBox, objects_of_boxes
from .carla_files import Halves, Matrix4, folders_that, laz_sensor, numbered, read_document, right_handed_matrix
from .dataset import DatasetSequence, Layout, Request

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


def _clips(folder: Path) -> dict[str, Path]:
    """Return the folder itself by name if it is a clip, else the clips in it."""
    return folders_that(lambda path: (path / "anno").is_dir() and (path / "camera" / "rgb_front").is_dir(), folder)


def _read(request: Request) -> DatasetSequence:
    clip, notes, camera = request.path, request.notes, request.path / "camera"
    sensors = {role: sensor_in(camera / n, role) for role, n in _FRONT.items() if (camera / n).is_dir()}
    others = sorted(path.name for path in camera.iterdir() if path.name not in _FRONT.values())
    notes += [f"camera/ {', '.join(others)} are left out: rgb_front is the front camera"] if others else []
    notes += ["radar/ is left out"] if (clip / "radar").is_dir() else []
    sensors = with_headers(sensors | laz_sensor(request, sensors["image"]))
    annotations = {
        number: (path, checked(path, TypeAdapter(_Annotation), read_document(path)))
        for number, path in numbered(clip / "anno", "*.json.gz").items()
    }
    poses: dict[int, Float] = {}
    boxes: dict[int, list[LabelledBox]] = {}
    for number, (path, found) in annotations.items():
        if (world_T_ego := _ego_pose(path, found)) is not None:
            poses[number], boxes[number] = world_T_ego, list(_boxes(path, found, inverse(world_T_ego)))
    if not annotations:
        raise DumpError(f"{clip / 'anno'}: expected annotations such as 00000.json.gz, found none")
    path, first = next(iter(annotations.values()))
    front = first.sensors.CAM_FRONT
    ego_T_camera = right_handed_matrix(f"{clip}: cam2ego of CAM_FRONT", front.cam2ego)
    rig = front_rig(
        f"{path}: sensors.CAM_FRONT.intrinsic",
        sensors["image"].size,
        np.array(front.intrinsic),
        "corner",
        (ego_T_camera @ rigid(EGO_R_OPTICAL, np.zeros(3)), np.eye(4) if LIDAR in sensors else None),
    )
    rate_hz = request.options.rate_hz or _RATE_HZ
    return DatasetSequence(
        title=f"Bench2Drive, {request.name}",
        sensors=sensors,
        stamps_ns=stamps_of_rate(list(sensors["image"].files), rate_hz),
        timing=f"{rate_hz:g} Hz by frame number",
        rig=rig,
        poses=poses,
        truth=objects_of_boxes(rig, boxes),
        tag_table=_CARLA,
        grey_depth="linear grey to 255 m",
        pixel_origin="the first pixel's corner, as CARLA has it",
    )


LAYOUT: Final = Layout(_read, ("--sequence", "--rate", "--allow-lossy-tags"), _clips)


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
