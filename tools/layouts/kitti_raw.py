"""KITTI raw: ``2011_09_26/2011_09_26_drive_0001_sync`` with images, points and oxts; the calibration is beside it.

The number of a file is the line of its stamp from 0. The stamps of ``image_00`` are those of all sensors.
"""

import re
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float
from roadperc_stream.input.calibrations import LIDAR

from ..readers.documents import frame_number, pose, read_lines
from ..readers.frame_stamps import mean_rate, stamps_by_line
from ..readers.sensor_folders import sensor_in, with_headers
from .dataset import DatasetSequence, Layout, Request
from .kitti import (
    PIXEL_ORIGIN,
    cameras_in,
    cameras_of,
    height_of,
    kitti_rig,
    matrix_of,
    packet,
    pose_of,
    poses_of,
    read_matrices,
)

_DRIVE: Final = re.compile(r"(\d{4}_\d\d_\d\d)_drive_(\d{4})_sync")
_CAMERA: Final = "image_0"
_CALIBRATION: Final = "calib_cam_to_cam.txt"
_LIDAR_CALIBRATION: Final = "calib_velo_to_cam.txt"
_IMU_CALIBRATION: Final = "calib_imu_to_velo.txt"
_STAMPS: Final = "timestamps.txt"
_POINTS: Final = "velodyne_points"
_TRACKLETS: Final = "tracklet_labels.xml"


def _drives(folder: Path) -> dict[str, Path]:
    """Return the drives of a folder by number, or by name if there are several dates."""
    inside = [folder] if _DRIVE.fullmatch(folder.absolute().name) else sorted(folder.glob("*_drive_*_sync"))
    found = inside or sorted(folder.glob("*/*_drive_*_sync"))
    named = [(match, path) for path in found if (match := _DRIVE.fullmatch(path.absolute().name))]
    several = len({match[1] for match, _ in named}) > 1
    return {match[0 if several else 2]: path for match, path in named if cameras_in(path, _CAMERA)}


def _read(request: Request) -> DatasetSequence:
    drive, notes = request.path, request.notes
    notes += [f"{_TRACKLETS} is left out"] if (drive / _TRACKLETS).exists() else []
    calibration = drive.absolute().parent / _CALIBRATION
    if not calibration.is_file():
        raise DumpError(f"{calibration}: no such file; put KITTI's calibration of the date beside the drive")
    matrices = read_matrices(calibration)
    sensors, projections = cameras_of(request, _CAMERA, "P_rect_0", calibration, matrices)
    rectification = pose_of(calibration, matrices, "R_rect_00")
    camera0_T_lidar = _calibrated(calibration.with_name(_LIDAR_CALIBRATION), rectification)
    camera0_T_imu = _calibrated(calibration.with_name(_IMU_CALIBRATION), camera0_T_lidar)
    if (drive / _POINTS).is_dir() and camera0_T_lidar is None:
        notes.append(f"{_POINTS}/ is left out: no {_LIDAR_CALIBRATION} beside the drive")
    elif (drive / _POINTS).is_dir():
        sensors[LIDAR] = sensor_in(drive / _POINTS, LIDAR)
        notes.append(f"{_POINTS}: the points are not motion-compensated: a scan takes 0.1 s")
    sensors = with_headers(sensors)
    rig, ego_T_camera0 = kitti_rig(calibration, projections, sensors, camera0_T_lidar, height_of(request))
    frames = sorted({number for role in projections for number in sensors[role].files})
    stamps_ns, timing = _stamps(request, sensors["image"].first, frames)
    return DatasetSequence(
        title=f"KITTI raw, {drive.absolute().name}",
        sensors=sensors,
        stamps_ns=stamps_ns,
        timing=timing,
        rig=rig,
        poses=_poses(request, None if camera0_T_imu is None else ego_T_camera0 @ camera0_T_imu),
        pixel_origin=PIXEL_ORIGIN,
    )


LAYOUT: Final = Layout(_read, ("--sequence", "--height"), _drives)


def _calibrated(path: Path, camera0_T_parent: Float | None) -> Float | None:
    """Return the (4, 4) transform to camera 0 of the sensor of a file with R and T; None without file or parent."""
    if camera0_T_parent is None or not path.is_file():
        return None
    matrices = read_matrices(path)
    rotation, shift_m = matrix_of(path, matrices, "R"), matrices.get("T", np.empty(0))
    if rotation.shape != (3, 3) or shift_m.shape != (3,):
        raise DumpError(f"{path}: expected R with 9 and T with 3 numbers, found {rotation.size} and {shift_m.size}")
    return camera0_T_parent @ pose(f"{path}: R and T", np.column_stack((rotation, shift_m)))


def _stamps(request: Request, front: Path, frames: list[int]) -> tuple[dict[int, int], str]:
    """Return the stamps of the images with a time, and their source; adds a note about the others."""
    path = request.path / f"{_CAMERA}0" / _STAMPS
    if not path.is_file():
        path = front.parent.parent / _STAMPS
    stamps_ns = stamps_by_line(path, frames)
    if without := [number for number in frames if number not in stamps_ns]:
        missing = f"{path}: line {without[0] + 1}: no time: {len(without)} of {len(frames)} images are left out"
        if not stamps_ns:
            raise DumpError(missing)
        request.notes.append(missing)
    return stamps_ns, f"stamps of {path.parent.name}{mean_rate(list(stamps_ns.values()))}"


def _poses(request: Request, ego_T_imu: Float | None) -> dict[int, Float]:
    """Return odom_T_ego by number; adds a note if there are none."""
    files = sorted((request.path / "oxts" / "data").glob("*.txt"))
    if not files or ego_T_imu is None:
        missing = f"{_LIDAR_CALIBRATION} or {_IMU_CALIBRATION} beside the drive" if files else "oxts/data"
        request.notes.append(f"no true poses: no {missing}")
        return {}
    numbered = ((frame_number(path.stem), path) for path in files)
    packets = {n: packet(f"{path}: line 1", " ".join(read_lines(path)[:1])) for n, path in numbered if n is not None}
    return poses_of(packets, ego_T_imu)
