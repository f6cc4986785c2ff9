"""Routes of agents of CARLA's leaderboard: the course of 2020, TransFuser and carla_garage.

``measurements`` hold the pose of the car. ``ego_matrix`` is CARLA's transform; without it x, y and theta are
left-handed, and theta is the direction of motion atan2(dy, dx).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter

from roadperc_stream.config.calibration import CarlaPose, Number
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse, mounting, rigid
from roadperc_stream.geometry.cameras import pinhole_of_fov
from roadperc_stream.input.calibrations import LIDAR, right_handed

from ..readers.depth_files import DepthEncoding
from ..readers.documents import Document, Id, Listed, checked
from ..readers.frame_stamps import stamps_of_rate
from ..readers.sensor_folders import Sensor, sensor_in, with_headers
from ..rig import front_rig
from .boxes import LabelledBox, objects_of_boxes
from .carla_files import Halves, Matrix4, folders_that, laz_sensor, numbered, read_document, right_handed_matrix
from .dataset import DatasetSequence, Layout, Request


@dataclass(frozen=True)
class _Recorder:
    """What a recorder does not write down: its camera, level, on the car's axis, and its rate."""

    name: str
    rate_hz: float
    x_m: float
    z_m: float
    fov_deg: float
    cameras: int = 1
    """Cameras side by side in an image."""
    depth: DepthEncoding | None = None


_COURSE: Final = _Recorder("CARLA leaderboard", 2.0, 1.3, 1.3, 90.0)
_RECORDERS: Final = {
    "boxes": _Recorder("carla_garage", 4.0, -1.5, 2.0, 110.0, depth="linear grey to 50 m"),
    "label_raw": _Recorder("TransFuser", 2.0, 1.3, 2.3, 60.0, cameras=3),
    "rgb_front": _Recorder("TransFuser of 2021", 2.0, 1.3, 2.3, 100.0),
}
"""Recorder by a folder that only it writes."""
_WIDE: Final = 5.0
"""An image this many times as wide as high is three cameras side by side."""
_LABELS: Final = {"car": "car", "static_car": "car", "walker": "pedestrian"}
_FOLDERS: Final = frozenset(("rgb", "rgb_front", "measurements", "boxes", "label_raw", "semantics", "depth", "lidar"))


class _Measurement(Document):
    ego_matrix: Matrix4 | None = None
    pos_global: tuple[Number, Number] | None = None
    x: Number | None = None
    y: Number | None = None
    theta: Number


class _Label(Document):
    matrix: Matrix4 | None = None
    ego_matrix: Matrix4 | None = None
    extent: Halves
    num_points: int | None = None
    id: Id = ""


def _routes(folder: Path) -> dict[str, Path]:
    """Return the folder itself by name if it is a route, else the routes in it."""
    return folders_that(lambda path: (path / "measurements").is_dir() and _front(path).is_dir(), folder)


def _front(route: Path) -> Path:
    return route / ("rgb" if (route / "rgb").is_dir() else "rgb_front")


def _read(request: Request) -> DatasetSequence:
    route, options, notes = request.path, request.options, request.notes
    recorder = next((found for marker, found in _RECORDERS.items() if (route / marker).is_dir()), _COURSE)
    sensors = with_headers(_sensors(request, recorder))
    width, height = sensors["image"].size or (1, 1)
    if width >= _WIDE * height:
        recorder = replace(recorder, cameras=3)
    sensors = {role: _of_one_camera(sensor, recorder.cameras) for role, sensor in sensors.items()}
    width //= recorder.cameras
    fov_deg, rate_hz = options.fov_deg or recorder.fov_deg, options.rate_hz or recorder.rate_hz
    z_m = options.height_m or recorder.z_m
    f_px = pinhole_of_fov(fov_deg, width, height)[0]
    K = np.array([(f_px, 0, width / 2), (0, f_px, height / 2), (0, 0, 1)])
    mountings = mounting(x=recorder.x_m, z=z_m), np.eye(4) if LIDAR in sensors else None
    rig = front_rig(f"{route}: image", sensors["image"].size, K, "corner", mountings)
    notes.append(
        f"assumed: level camera {recorder.x_m:g} m forward, {z_m:g} m up, {fov_deg:g} degrees, {rate_hz:g} Hz, "
        f"as in {recorder.name}; change it with --height, --fov and --rate"
    )
    poses = _poses(request)
    boxes = {
        number: list(_boxes(path, poses[number]))
        for name in ("label_raw", "boxes")
        for number, path in numbered(route / name, "*.json*").items()
        if number in poses
    }
    return DatasetSequence(
        title=f"{recorder.name}, {request.name}",
        sensors=sensors,
        stamps_ns=stamps_of_rate(list(sensors["image"].files), rate_hz),
        timing=f"{rate_hz:g} Hz by frame number",
        rig=rig,
        poses=poses,
        truth=objects_of_boxes(rig, boxes),
        side_by_side=recorder.cameras,
        grey_depth=recorder.depth,
    )


LAYOUT: Final = Layout(
    _read, ("--sequence", "--rate", "--fov", "--height", "--depth-coding", "--tags", "--allow-lossy-tags"), _routes
)


def _sensors(request: Request, recorder: _Recorder) -> dict[str, Sensor]:
    route, notes, front = request.path, request.notes, _front(request.path)
    sensors = {"image": sensor_in(front, "image")}
    for role, name in (("segmentation", "semantics"), ("depth", "depth")):
        if not (route / name).is_dir():
            continue
        if recorder.cameras > 1 and role == "depth":
            notes.append("depth/ is left out: TransFuser stores its channels in reverse order")
        elif recorder.cameras > 1 and not request.options.allow_lossy_tags:
            notes.append("semantics/ is left out: lights have tags that CARLA lacks; pass --allow-lossy-tags to use it")
        else:
            sensors[role] = sensor_in(route / name, role)
    others = sorted(path.name for path in route.iterdir() if path.is_dir() and path.name not in _FOLDERS)
    notes += [f"{', '.join(others)} are left out: {front.name} is the front camera"] if others else []
    return sensors | laz_sensor(request, sensors["image"])


def _of_one_camera(sensor: Sensor, cameras: int) -> Sensor:
    return replace(sensor, sizes={n: (width // cameras, height) for n, (width, height) in sensor.sizes.items()})


def _poses(request: Request) -> dict[int, Float]:
    """Return odom_T_ego by frame number; odom is the left-handed plane of the measurements, mirrored."""
    poses: dict[int, Float] = {}
    is_flat = False
    for number, path in numbered(request.path / "measurements", "*.json*").items():
        found = checked(path, TypeAdapter(_Measurement), read_document(path))
        x, y = found.pos_global or (found.x, found.y)
        if found.ego_matrix is not None:
            poses[number] = right_handed_matrix(f"{path}: ego_matrix", found.ego_matrix)
        elif x is not None and y is not None:
            poses[number] = right_handed(CarlaPose(x=x, y=y, z=0.0, yaw=float(np.rad2deg(found.theta))))
            is_flat = True
        else:
            raise DumpError(f"{path}: expected x and y, pos_global or ego_matrix")
    request.notes.extend(["true poses are flat: the measurements have x, y and theta"] * is_flat)
    return poses


def _boxes(path: Path, world_T_ego: Float) -> Iterator[LabelledBox]:
    """Yield the boxes of vehicles and walkers that the lidar hits; traffic lights and signs are areas of the road.

    The origin of a vehicle is on the road below the middle of its box, that of a walker in the middle.
    TransFuser has height, length and width in ``extent``, carla_garage halves of length, width and height.
    """
    for row in checked(path, TypeAdapter(Listed[dict[str, Any]]), read_document(path)):
        kind = row.get("class")
        label = _LABELS.get(kind.lower()) if isinstance(kind, str) else None
        if label is None or row.get("num_points") == 0 or row.get("distance") == -1:
            continue
        found = checked(path, TypeAdapter(_Label), row)
        matrix = found.matrix or found.ego_matrix
        if matrix is None:
            raise DumpError(f"{path}: {kind} {found.id}: expected matrix or ego_matrix")
        a, b, c = found.extent
        size_m = (b, c, a) if kind == "Car" else (2 * a, 2 * b, 2 * c)
        up_m = 0.0 if label == "pedestrian" else size_m[2] / 2
        middle = rigid(np.eye(3), np.array([0.0, 0.0, up_m]))
        world_T_base = right_handed_matrix(f"{path}: {kind} {found.id}", matrix)
        yield LabelledBox(label, inverse(world_T_ego) @ world_T_base @ middle, size_m, str(found.id))
