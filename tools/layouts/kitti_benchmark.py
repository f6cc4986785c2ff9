"""What KITTI's object and tracking benchmarks share: splits, calibration files, and labels with 2D and 3D boxes.

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
from roadperc_stream.model import Object
from roadperc_stream.system.text import whole_number

from ..carla_dump.detection_files import KITTI_IGNORED, kitti_detection
from ..carla_dump.json_files import numbers, read_lines
from ..carla_dump.layout import sensor_in
from ..carla_dump.survey import SensorSurvey, surveyed
from ..rig import Rig
from . import kitti_calibration as kitti
from .boxes import box_distance_m

_PROJECTIONS: Final = {"image": "P2", "right": "P3"}
_IMU: Final = ("Tr_imu_velo", "Tr_imu_to_velo")
_COLUMNS: Final = 15


def splits_of(folder: Path, images: str) -> dict[str, Path]:
    """Return the folders with the images and ``calib`` by name: ``training``, ``testing``, or the folder itself."""
    places = {name: folder / name for name in ("training", "testing")} | {folder.absolute().name: folder}
    return {name: path for name, path in places.items() if (path / images).is_dir() and (path / "calib").is_dir()}


def surveys_of(split: Path, folders: Mapping[str, str]) -> dict[str, SensorSurvey]:
    """Return the surveys of the folders that exist, by role."""
    there = {role: name for role, name in folders.items() if (split / name).is_dir()}
    return surveyed({role: replace(sensor_in(split / name, role), source=name) for role, name in there.items()})


@dataclass(frozen=True)
class Calibration:
    """A calibration file; the transforms are (4, 4), and ``ego_T_imu`` is None without its line."""

    rig: Rig
    front_T_camera0: Float
    ego_T_imu: Float | None


def read_calibration(path: Path, surveys: Mapping[str, SensorSurvey], height_m: float, number: int = -1) -> Calibration:
    """Read a calibration file; the images have the size of the frame ``number``, else of most frames.

    Raises:
        DumpError: a line is missing or wrong; the message names it.
    """
    matrices = kitti.read_matrices(path)
    camera0_T_lidar = ego_T_imu = None
    if LIDAR in surveys or any(name in matrices for name in _IMU):
        rectification = kitti.pose_of(path, matrices, "R_rect", "R0_rect")
        camera0_T_lidar = rectification @ kitti.pose_of(path, matrices, "Tr_velo_cam", "Tr_velo_to_cam")
    projections = {role: kitti.matrix_of(path, matrices, P) for role, P in _PROJECTIONS.items() if role in surveys}
    rig, ego_T_camera0 = kitti.rig(path, projections, surveys, camera0_T_lidar, height_m, number)
    if camera0_T_lidar is not None and any(name in matrices for name in _IMU):
        ego_T_imu = ego_T_camera0 @ camera0_T_lidar @ kitti.pose_of(path, matrices, *_IMU)
    return Calibration(rig, inverse(mounting(z=height_m)) @ ego_T_camera0, ego_T_imu)


def read_labels(path: Path, calibration: Calibration, before: int = 0) -> Iterator[tuple[int, Object]]:
    """Yield frame number and true object of each line, except regions that are not labelled.

    With two columns ``before`` those of an object, they are frame number and id; else the file's name is the number.

    Raises:
        DumpError: a line is wrong; the message names it.
    """
    for at, line in enumerate(read_lines(path), 1):
        where, fields = f"{path}: line {at}", line.split()
        if not fields:
            continue
        text, name = fields[:2] if before and len(fields) > 1 else (path.stem, f"{path.stem}/{at}")
        number = whole_number(text)
        if len(fields) - before not in (_COLUMNS, _COLUMNS + 1) or number is None:
            raise DumpError(
                f"{where}: expected {before + _COLUMNS} columns of a label, found {len(fields)}: {line[:60]!r}"
            )
        if (found := _object(where, fields[before:], name, calibration)) is not None:
            yield number, found


def _object(where: str, fields: list[str], name: str, calibration: Calibration) -> Object | None:
    detection = kitti_detection(where, fields)
    if detection.label == KITTI_IGNORED:
        return None
    height_m, width_m, length_m, x_m, y_m, z_m, rotation = numbers(where, fields[8:_COLUMNS]).tolist()
    if min(height_m, width_m, length_m) <= 0:
        raise DumpError(f"{where}: expected a 3D box with sizes above 0, found {' '.join(fields[8:_COLUMNS])}")
    camera0_T_box = rigid(rotation_from_rpy(0.0, rotation, 0.0), np.array((x_m, y_m - height_m / 2, z_m)))
    front_T_box, size_m = calibration.front_T_camera0 @ camera0_T_box, np.array((length_m, height_m, width_m))
    distance_m = box_distance_m(calibration.rig.camera_of("image"), front_T_box, size_m)
    return Object(replace(detection, id=name), kept=True, track_id=name, distance_m=distance_m)
