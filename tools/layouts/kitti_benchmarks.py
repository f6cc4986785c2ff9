"""KITTI's object and tracking benchmarks, below ``training`` or ``testing``.

Object: ``image_2``, ``label_2``, ``calib`` and ``velodyne``. The frames are unrelated. Each has its own calibration and
size, and its number times 2 s as its stamp.

Tracking: ``image_02/NNNN``, ``label_02``, ``calib``, ``velodyne`` and ``oxts``. The stamp of a frame is its number over
10 Hz. A label begins with the number of its frame and an id.

The columns of a label are type, truncation, occlusion, alpha, 2D box, height, width, length, the middle of the 3D box's
lower side in camera 0, and its rotation about the y axis. Source: ``readme.txt`` of both development kits.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse, mounting, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.model import Object, Objects
from roadperc_stream.system.text import whole_number

from ..readers.detection_files import KITTI_COLUMNS, KITTI_IGNORED, kitti_detection
from ..readers.documents import numbers, read_lines
from ..readers.frame_stamps import stamps_of_rate
from ..readers.sensor_folders import Sensor, sensor_in, with_headers
from ..readers.truth_file import TruthTables
from ..rig import Rig
from .boxes import box_distance_m
from .dataset import DatasetSequence, Layout, Request
from .kitti import PIXEL_ORIGIN, height_of, kitti_rig, matrix_of, packet, pose_of, poses_of, read_matrices

_PROJECTIONS: Final = {"image": "P2", "right": "P3"}
_IMU: Final = ("Tr_imu_velo", "Tr_imu_to_velo")
_OBJECT_RATE_HZ: Final = 0.5
_TRACKING_RATE_HZ: Final = 10.0


def _splits(folder: Path, images: str) -> dict[str, Path]:
    """Return the folders with the images and ``calib`` by name: ``training``, ``testing``, or the folder itself."""
    places = {name: folder / name for name in ("training", "testing")} | {folder.absolute().name: folder}
    return {name: path for name, path in places.items() if (path / images).is_dir() and (path / "calib").is_dir()}


def _sequences(folder: Path) -> dict[str, Path]:
    """Return the folders of images of tracking by sequence, or by split and sequence if there are two splits."""
    splits = _splits(folder, "image_02")
    return {
        f"{name}/{path.name}" if len(splits) > 1 else path.name: path
        for name, split in splits.items()
        for path in sorted((split / "image_02").iterdir())
        if path.name.isdecimal() and path.is_dir()
    }


def _read_object(request: Request) -> DatasetSequence:
    split, notes = request.path, request.notes
    notes.append("the frames are unrelated, 2 s apart, each with its own calibration")
    sensors = _sensors(split, {"image": "image_2", "right": "image_3", LIDAR: "velodyne"})
    height_m = height_of(request)
    frames = sorted(sensors["image"].files)
    calibrations = {n: _calibration(split / f"calib/{n:06d}.txt", sensors, height_m, n) for n in frames}
    paths = {number: path for number in frames if (path := split / f"label_2/{number:06d}.txt").is_file()}
    if len(paths) < len(frames):
        notes.append(f"label_2: {len(frames) - len(paths)} of {len(frames)} images have no labels")
    objects = {n: [found for _, found in _labels(path, calibrations[n])] for n, path in paths.items()}
    rigs = {number: found.rig for number, found in calibrations.items()}
    found = _dataset(f"KITTI object, {request.name}", "label_2", sensors, _OBJECT_RATE_HZ, objects, rigs[frames[0]])
    return replace(found, timing="2 s by frame number", frame_rigs=rigs)


def _read_tracking(request: Request) -> DatasetSequence:
    split, sequence, notes = request.path.parent.parent, request.path.name, request.notes
    folders = {"image": "image_02", "right": "image_03", LIDAR: "velodyne"}
    sensors = _sensors(split, {role: f"{top}/{sequence}" for role, top in folders.items()})
    calibration = _calibration(split / "calib" / f"{sequence}.txt", sensors, height_of(request))
    frames = sorted(sensors["image"].files)
    labels, packets = split / "label_02" / f"{sequence}.txt", split / "oxts" / f"{sequence}.txt"
    objects: dict[int, list[Object]] = {}
    if labels.is_file():
        objects = {number: [] for number in frames}
        for number, found in _labels(labels, calibration, before=2):
            objects.get(number, []).append(found)
    else:
        notes.append(f"no labels: {labels} does not exist")
    poses: dict[int, Float] = {}
    if packets.is_file() and calibration.ego_T_imu is not None:
        lines = read_lines(packets)
        known = {n: packet(f"{packets}: line {n + 1}", lines[n]) for n in frames if n < len(lines)}
        poses = poses_of(known, calibration.ego_T_imu)
    else:
        notes.append(f"no true poses: no {'Tr_imu_velo in calib' if packets.is_file() else packets}")
    title = f"KITTI tracking, sequence {request.name}"
    return replace(_dataset(title, "label_02", sensors, _TRACKING_RATE_HZ, objects, calibration.rig), poses=poses)


OBJECT: Final = Layout(_read_object, ("--sequence", "--height"), lambda folder: _splits(folder, "image_2"))
TRACKING: Final = Layout(_read_tracking, ("--sequence", "--height"), _sequences)


def _dataset(
    title: str,
    labels: str,
    sensors: Mapping[str, Sensor],
    rate_hz: float,
    objects: Mapping[int, list[Object]],
    rig: Rig,
) -> DatasetSequence:
    """Return what both benchmarks have; the stamps count from frame 0."""
    frames = sorted(sensors["image"].files)
    return DatasetSequence(
        title=title,
        sensors=sensors,
        stamps_ns={n: ns for n, ns in stamps_of_rate([0, *frames], rate_hz).items() if n in set(frames)},
        timing=f"{rate_hz:g} Hz by frame number (KITTI)",
        rig=rig,
        detections={number: tuple(item.detection for item in found) for number, found in objects.items()},
        detections_source=f"{labels}, 2D boxes of the labels",
        truth=TruthTables(objects={number: Objects(tuple(found)) for number, found in objects.items()}),
        pixel_origin=PIXEL_ORIGIN,
    )


def _sensors(split: Path, folders: Mapping[str, str]) -> dict[str, Sensor]:
    """Return the sensors of the folders that exist, by role."""
    there = {role: name for role, name in folders.items() if (split / name).is_dir()}
    return with_headers({role: replace(sensor_in(split / name, role), source=name) for role, name in there.items()})


@dataclass(frozen=True)
class _Calibration:
    """A calibration file; the transforms are (4, 4), and ``ego_T_imu`` is None without its line."""

    rig: Rig
    front_T_camera0: Float
    ego_T_imu: Float | None


def _calibration(path: Path, sensors: Mapping[str, Sensor], height_m: float, number: int = -1) -> _Calibration:
    """Read a calibration file; the images have the size of the frame ``number``, else of most frames."""
    matrices = read_matrices(path)
    camera0_T_lidar = ego_T_imu = None
    if LIDAR in sensors or any(name in matrices for name in _IMU):
        rectification = pose_of(path, matrices, "R_rect", "R0_rect")
        camera0_T_lidar = rectification @ pose_of(path, matrices, "Tr_velo_cam", "Tr_velo_to_cam")
    projections = {role: matrix_of(path, matrices, P) for role, P in _PROJECTIONS.items() if role in sensors}
    rig, ego_T_camera0 = kitti_rig(path, projections, sensors, camera0_T_lidar, height_m, number)
    if camera0_T_lidar is not None and any(name in matrices for name in _IMU):
        ego_T_imu = ego_T_camera0 @ camera0_T_lidar @ pose_of(path, matrices, *_IMU)
    return _Calibration(rig, inverse(mounting(z=height_m)) @ ego_T_camera0, ego_T_imu)


def _labels(path: Path, calibration: _Calibration, before: int = 0) -> Iterator[tuple[int, Object]]:
    """Yield frame number and true object of each line, except regions that are not labelled.

    With two columns ``before`` those of an object, they are frame number and id; else the file's name is the number.
    """
    for at, line in enumerate(read_lines(path), 1):
        where, fields = f"{path}: line {at}", line.split()
        if not fields:
            continue
        text, name = fields[:2] if before and len(fields) > 1 else (path.stem, f"{path.stem}/{at}")
        number = whole_number(text)
        if len(fields) - before not in (KITTI_COLUMNS, KITTI_COLUMNS + 1) or number is None:
            raise DumpError(
                f"{where}: expected {before + KITTI_COLUMNS} columns of a label, found {len(fields)}: {line[:60]!r}"
            )
        if (found := _object(where, fields[before:], name, calibration)) is not None:
            yield number, found


def _object(where: str, fields: list[str], name: str, calibration: _Calibration) -> Object | None:
    detection = kitti_detection(where, fields)
    if detection.label == KITTI_IGNORED:
        return None
    height_m, width_m, length_m, x_m, y_m, z_m, rotation = numbers(where, fields[8:KITTI_COLUMNS]).tolist()
    if min(height_m, width_m, length_m) <= 0:
        raise DumpError(f"{where}: expected a 3D box with sizes above 0, found {' '.join(fields[8:KITTI_COLUMNS])}")
    camera0_T_box = rigid(rotation_from_rpy(0.0, rotation, 0.0), np.array((x_m, y_m - height_m / 2, z_m)))
    front_T_box, size_m = calibration.front_T_camera0 @ camera0_T_box, np.array((length_m, height_m, width_m))
    distance_m = box_distance_m(calibration.rig.camera_of("image"), front_T_box, size_m)
    return Object(replace(detection, id=name), kept=True, track_id=name, distance_m=distance_m)
