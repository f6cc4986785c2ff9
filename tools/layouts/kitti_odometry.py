"""KITTI odometry: ``sequences/NN`` with ``poses/NN.txt``, or one sequence alone with ``poses.txt`` beside its images.

Poses are those of the left grey camera relative to the first frame. The points are motion-compensated by KITTI.
"""

import re
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.system.text import number as counted

from ..readers.calibration_file import CALIBRATION_NAME
from ..readers.documents import numbers, pose, read_lines
from ..readers.frame_stamps import mean_rate, stamps_by_line, stamps_of_rate
from ..readers.sensor_folders import sensor_in, with_headers
from .dataset import DatasetSequence, Layout, Request
from .kitti import PIXEL_ORIGIN, cameras_in, cameras_of, height_of, kitti_rig, pose_of, read_matrices

_CALIBRATION: Final = "calib.txt"
_CAMERA: Final = "image_"
_RATE_HZ: Final = 10.0
_POSE_NUMBERS: Final = 12


def _sequences(folder: Path) -> dict[str, Path]:
    """Return the sequences of a folder by name; the folder may be one itself."""
    if cameras_in(folder, _CAMERA):
        return {folder.absolute().name: folder}
    inside = next((path for path in (folder / "dataset/sequences", folder / "sequences") if path.is_dir()), folder)
    if inside.absolute().name != "sequences":
        return {}
    return {path.name: path for path in sorted(inside.iterdir()) if cameras_in(path, _CAMERA)}


def _detect(folder: Path) -> bool:
    calibrated = any((path / _CALIBRATION).is_file() for path in _sequences(folder).values())
    return calibrated and not (folder / CALIBRATION_NAME).exists()


def _read(request: Request) -> DatasetSequence:
    sequence, name, notes = request.path, request.name, request.notes
    calibration = sequence / _CALIBRATION
    matrices = read_matrices(calibration)
    sensors, projections = cameras_of(request, _CAMERA, "P", calibration, matrices)
    camera0_T_lidar = pose_of(calibration, matrices, "Tr") if "Tr" in matrices else None
    if (sequence / "velodyne").is_dir():
        if camera0_T_lidar is None:
            notes.append(f"velodyne/ is left out: {_CALIBRATION} has no Tr; KITTI's calibration archive has it")
        else:
            sensors[LIDAR] = sensor_in(sequence / "velodyne", LIDAR)
    sensors = with_headers(sensors)
    rig, ego_T_camera0 = kitti_rig(calibration, projections, sensors, camera0_T_lidar, height_of(request))
    frames = sorted({number for role in projections for number in sensors[role].files})
    if absent := frames[-1] - frames[0] + 1 - len(frames):
        notes.append(f"{counted(absent, 'image')} missing between {frames[0]} and {frames[-1]}")
    stamps_ns, timing = _stamps(sequence / "times.txt", frames, request.options.rate_hz)
    return DatasetSequence(
        title=f"KITTI odometry{f', sequence {name}' if name.isdigit() else ''}",
        sensors=sensors,
        stamps_ns=stamps_ns,
        timing=timing,
        rig=rig,
        poses=_poses(request, ego_T_camera0),
        pixel_origin=PIXEL_ORIGIN,
    )


LAYOUT: Final = Layout(_read, ("--sequence", "--rate", "--height"), _sequences, _detect)


def _stamps(times: Path, frames: list[int], asked_hz: float | None) -> tuple[dict[int, int], str]:
    """Return the stamp of each frame, and their source."""
    if not times.is_file():
        rate_hz = asked_hz or _RATE_HZ
        return stamps_of_rate(frames, rate_hz), f"{rate_hz:g} Hz by frame number{'' if asked_hz else ' (KITTI)'}"
    if asked_hz:
        raise DumpError(f"--rate {asked_hz:g}: {times.name} has the stamps; remove --rate")
    stamps_ns = stamps_by_line(times, frames)
    if len(stamps_ns) < len(frames):
        missing = next(number for number in frames if number not in stamps_ns)
        raise DumpError(f"{times}: line {missing + 1}: no time for image {missing}")
    return stamps_ns, f"stamps of {times.name}{mean_rate(list(stamps_ns.values()))}"


def _poses(request: Request, ego_T_camera0: Float) -> dict[int, Float]:
    """Return odom_T_ego by frame number; the odom frame is the ego frame of the first line."""
    sequence = request.path.absolute()
    places = (request.path / "poses.txt", sequence.parent.parent / "poses" / f"{sequence.name}.txt")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        request.notes.append(f"no true poses: neither {places[0]} nor {places[1]} exists")
        return {}
    poses: dict[int, Float] = {}
    for number, line in enumerate(read_lines(path)):
        if line.strip():
            poses[number] = ego_T_camera0 @ _pose(f"{path}: line {number + 1}", line) @ inverse(ego_T_camera0)
    return poses


def _pose(where: str, line: str) -> Float:
    """Return the (4, 4) pose of camera 0 relative to the first frame."""
    values = numbers(where, re.split(r"[,\s]+", line.strip()))
    if values.size != _POSE_NUMBERS:
        raise DumpError(f"{where}: expected 12 finite numbers, found {values.size}: {line[:60]!r}")
    return pose(where, values.reshape(3, 4))
