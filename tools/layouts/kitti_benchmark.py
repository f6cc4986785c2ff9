"""What KITTI's object and tracking benchmarks share: splits, calibration files, and labels with 2D and 3D boxes.

The columns of a label are type, truncation, occlusion, alpha, 2D box, height, width, length, the middle of the 3D box's
lower side in camera 0, and its rotation about the y axis. Source: ``readme.txt`` of both development kits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model import Detection, Object, Objects

from ..carla_dump.camera_rig import LIDAR, Rig, Size
from ..carla_dump.detection_files import KITTI_IGNORED, kitti_detection
from ..carla_dump.layout import Sensor, sensor_in
from .box_truth import box_distance_m
from .kitti_calibration import kitti_rig, matrix_of, mounting_of_camera0, read_matrices, square

_SPLITS: Final = ("training", "testing")
_PROJECTIONS: Final = {"image": "P2", "right": "P3"}
_SHAPE: Final = slice(8, 15)
"""Columns of size, place and rotation."""


def splits_of(folder: Path, images: str) -> dict[str, Path]:
    """Return the folders with the images and ``calib`` by name: ``training``, ``testing``, or the folder itself."""
    places = {name: folder / name for name in _SPLITS} | {folder.absolute().name: folder}
    return {name: path for name, path in places.items() if (path / images).is_dir() and (path / "calib").is_dir()}


def sensors_of(split: Path, folders: Mapping[str, str]) -> dict[str, Sensor]:
    """Return the sensors whose folders exist, by role."""
    return {
        role: replace(sensor_in(split / name, role), source=name)
        for role, name in folders.items()
        if (split / name).is_dir()
    }


@dataclass(frozen=True)
class Calibration:
    """A calibration file of a benchmark."""

    rig: Rig
    ego_T_camera0: Float
    """(4, 4)."""
    camera0_T_imu: Float | None
    """(4, 4), None without the lines of the lidar and the inertial unit."""


def read_calibration(
    path: Path, sizes: Mapping[str, Size], roles: Mapping[str, object], height_m: float
) -> Calibration:
    """Read a calibration file; names may be those of the object or of the tracking benchmark.

    Args:
        path: the file.
        sizes: columns and rows of the front camera and, if there is one, of the right camera, by role.
        roles: the roles of all sensors.
        height_m: height of the front camera.

    Raises:
        DumpError: a line is missing or wrong; the message names it.
    """
    matrices = read_matrices(path)
    projections = {role: matrix_of(path, matrices, _PROJECTIONS[role]) for role in sizes}
    ego_T_camera0 = mounting_of_camera0(f"{path}: image", projections["image"], height_m)
    lidar, imu = ("Tr_velo_cam", "Tr_velo_to_cam"), ("Tr_imu_velo", "Tr_imu_to_velo")
    camera0_T_lidar = camera0_T_imu = None
    if LIDAR in roles or any(name in matrices for name in lidar):
        rectification = square(matrix_of(path, matrices, "R_rect", "R0_rect"))
        camera0_T_lidar = rectification @ square(matrix_of(path, matrices, *lidar))
        if any(name in matrices for name in imu):
            camera0_T_imu = camera0_T_lidar @ square(matrix_of(path, matrices, *imu))
    rig = kitti_rig(path, projections, sizes, ego_T_camera0, camera0_T_lidar if LIDAR in roles else None)
    return Calibration(rig, ego_T_camera0, camera0_T_imu)


@dataclass(frozen=True)
class Label:
    """A labelled object; its 2D box is that of the visible part."""

    detection: Detection
    track_id: str
    camera0_T_box: Float
    """(4, 4) pose of the 3D box's middle; its axes are length, height and width."""
    size_m: Float
    """(3,) along these axes."""


def read_label(where: str, fields: Sequence[str], track_id: str = "") -> Label | None:
    """Return the object of the 15 columns of a label, or of 16 with a score; None for a region that is not labelled.

    Raises:
        DumpError: a column is wrong; the message starts with ``where``.
    """
    detection = kitti_detection(where, list(fields))
    if detection.label == KITTI_IGNORED:
        return None
    try:
        height_m, width_m, length_m, x, y, z, rotation = (float(text) for text in fields[_SHAPE])
    except ValueError as error:
        raise DumpError(f"{where}: {error}") from error
    size_m, shape = np.array((length_m, height_m, width_m)), (x, y, z, rotation)
    if not np.isfinite(shape).all() or not np.isfinite(size_m).all() or size_m.min() <= 0:
        raise DumpError(f"{where}: expected a 3D box with sizes above 0, found {' '.join(fields[_SHAPE])}")
    R = rotation_from_rpy(0.0, rotation, 0.0)
    return Label(detection, track_id, rigid(R, np.array((x, y - height_m / 2, z))), size_m)


def objects_of(labels: Sequence[Label], calibration: Calibration) -> Objects:
    """Return the true objects of a frame, with the distance from the front camera to each 3D box."""
    camera, mountings = calibration.rig.camera_of("image"), calibration.rig.transforms
    ego_T_image = next(edge.parent_T_child for edge in mountings if edge.child == camera.frame_id)
    image_T_camera0 = inverse(ego_T_image) @ calibration.ego_T_camera0
    return Objects(
        tuple(
            Object(
                replace(label.detection, id=label.track_id),
                kept=True,
                track_id=label.track_id,
                distance_m=box_distance_m(camera, image_T_camera0 @ label.camera0_T_box, label.size_m),
            )
            for label in labels
        )
    )
