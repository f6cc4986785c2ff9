"""KITTI odometry: ``sequences/NN`` with ``poses/NN.txt``, or one sequence alone with ``poses.txt`` beside its images.

Poses are those of the left grey camera relative to the first frame. The points are motion-compensated by KITTI.
"""

import re
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.system.text import number

from ..carla_dump.calibration_file import CALIBRATION_NAME
from ..carla_dump.frame_stamps import mean_rate, stamps_by_line, stamps_of_rate
from ..carla_dump.json_files import numbers, pose, read_lines
from ..carla_dump.layout import sensor_in
from ..carla_dump.survey import surveyed
from . import kitti_calibration as kitti
from .drive import ConvertOptions, Drive, choose_sequence

_CALIBRATION: Final = "calib.txt"
_CAMERA: Final = "image_"
_RATE_HZ: Final = 10.0
_POSE_NUMBERS: Final = 12


def detect(folder: Path) -> bool:
    """Return True if the folder is a sequence with images and ``calib.txt``, or holds some."""
    calibrated = any((path / _CALIBRATION).is_file() for path in _sequences(folder).values())
    return calibrated and not (folder / CALIBRATION_NAME).exists()


def read(folder: Path, options: ConvertOptions) -> Drive:
    """Read one sequence.

    Raises:
        DumpError: the folder holds no or several sequences, or a file is wrong; the message names file and line.
    """
    options.require_only(folder, "--sequence", "--rate", "--height")
    name, sequence = choose_sequence(folder, _sequences(folder), options.sequence)
    notes: list[str] = []
    calibration = sequence / _CALIBRATION
    matrices = kitti.read_matrices(calibration)
    sensors, projections = kitti.cameras_of(sequence, _CAMERA, "P", calibration, matrices, notes)
    camera0_T_lidar = kitti.pose_of(calibration, matrices, "Tr") if "Tr" in matrices else None
    if (sequence / "velodyne").is_dir():
        if camera0_T_lidar is None:
            notes.append(f"velodyne/ is left out: {_CALIBRATION} has no Tr; KITTI's calibration archive has it")
        else:
            sensors[LIDAR] = sensor_in(sequence / "velodyne", LIDAR)
    surveys = surveyed(sensors)
    height_m = kitti.height_of(options, notes)
    rig, ego_T_camera0 = kitti.rig(calibration, projections, surveys, camera0_T_lidar, height_m)
    frames = sorted({number for role in projections for number in surveys[role].sensor.files})
    if absent := frames[-1] - frames[0] + 1 - len(frames):
        notes.append(f"{number(absent, 'image')} missing between {frames[0]} and {frames[-1]}")
    stamps_ns, timing = _stamps(sequence / "times.txt", frames, options)
    return Drive(
        folder=folder,
        title=f"KITTI odometry{f', sequence {name}' if name.isdigit() else ''}",
        surveys=surveys,
        stamps_ns=stamps_ns,
        timing=timing,
        rig=rig,
        poses=_poses(sequence, ego_T_camera0, notes),
        pixel_origin=kitti.PIXEL_ORIGIN,
        notes=tuple(notes),
    )


def _sequences(folder: Path) -> dict[str, Path]:
    """Return the sequences of a folder by name; the folder may be one itself."""
    if kitti.cameras_in(folder, _CAMERA):
        return {folder.absolute().name: folder}
    inside = next((path for path in (folder / "dataset/sequences", folder / "sequences") if path.is_dir()), folder)
    if inside.absolute().name != "sequences":
        return {}
    return {path.name: path for path in sorted(inside.iterdir()) if kitti.cameras_in(path, _CAMERA)}


def _stamps(times: Path, frames: list[int], options: ConvertOptions) -> tuple[dict[int, int], str]:
    if not times.is_file():
        rate_hz = options.rate_hz or _RATE_HZ
        return stamps_of_rate(frames, rate_hz), f"{rate_hz:g} Hz by frame number{'' if options.rate_hz else ' (KITTI)'}"
    if options.rate_hz:
        raise DumpError(f"--rate {options.rate_hz:g}: {times.name} has the stamps; remove --rate")
    stamps_ns = stamps_by_line(times, frames)
    if len(stamps_ns) < len(frames):
        missing = next(number for number in frames if number not in stamps_ns)
        raise DumpError(f"{times}: line {missing + 1}: no time for image {missing}")
    return stamps_ns, f"stamps of {times.name}{mean_rate(list(stamps_ns.values()))}"


def _poses(sequence: Path, ego_T_camera0: Float, notes: list[str]) -> dict[int, Float]:
    """Return odom_T_ego by frame number; the odom frame is the ego frame of the first line.

    Raises:
        DumpError: a line is not a pose.
    """
    places = (sequence / "poses.txt", sequence.absolute().parent.parent / "poses" / f"{sequence.absolute().name}.txt")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        notes.append(f"no true poses: neither {places[0]} nor {places[1]} exists")
        return {}
    camera0_T_ego = inverse(ego_T_camera0)
    lines = enumerate(read_lines(path))
    return {number: ego_T_camera0 @ _pose(path, number, line) @ camera0_T_ego for number, line in lines if line.strip()}


def _pose(path: Path, number: int, line: str) -> Float:
    """Return the (4, 4) pose of camera 0 relative to the first frame."""
    where = f"{path}: line {number + 1}"
    values = numbers(where, re.split(r"[,\s]+", line.strip()))
    if values.size != _POSE_NUMBERS:
        raise DumpError(f"{where}: expected 12 finite numbers, found {values.size}: {line[:60]!r}")
    return pose(where, values.reshape(3, 4))
