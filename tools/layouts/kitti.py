"""What KITTI's datasets share: calibration files, the rig of rectified cameras and lidar, and the packets of ``oxts``.

The matrices P0 to P3 project from the frame of the rectified left grey camera (camera 0: x right, y down, z forward).

Raises everywhere:
    DumpError: a line of a file is missing or wrong; the message names it.
"""

import re
from collections.abc import Mapping
from math import asinh, cos, radians, tan
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, Float, inverse, mounting, pinhole_fault, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.input.calibrations import LIDAR
from roadperc_stream.input.projections import require_pinhole
from roadperc_stream.model import EGO, Transform

from ..readers.documents import numbers, pose, read_lines
from ..readers.sensor_folders import Sensor, sensor_in
from ..rig import FRONT, RIGHT, Rig
from .dataset import Request

HEIGHT_M: Final = 1.65
"""Height of all cameras above the road, from KITTI's description of the car; they are level."""
PIXEL_ORIGIN: Final = "the first pixel's centre, as KITTI has it"
_PAIRS: Final = ((2, 3), (0, 1))
"""Left and right camera: colour, then grey."""
_NUMBER: Final = re.compile(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")
_SHAPES: Final = {12: (3, 4), 9: (3, 3)}
_RADIUS_M: Final = 6_378_137.0
_PACKET: Final = 30
"""Numbers of a packet of ``oxts``."""


def read_matrices(path: Path) -> dict[str, Float]:
    """Return the numbers of each line ``name: numbers``, also without the colon: (3, 4), (3, 3), or flat.

    Lines without numbers, such as dates, are left out.
    """
    found: dict[str, Float] = {}
    for at, line in enumerate(read_lines(path), 1):
        name, *words = line.replace(":", " ", 1).split() or [""]
        if words and (name.startswith(("P", "R", "T")) or all(map(_NUMBER.fullmatch, words))):
            values = numbers(f"{path}: line {at}: {name}", words)
            found[name] = values.reshape(_SHAPES.get(len(values), (-1,)))
    return found


def pose_of(path: Path, matrices: Mapping[str, Float], *names: str) -> Float:
    """Return the (4, 4) pose with the first of these names that the file has."""
    return pose(f"{path}: {' or '.join(names)}", matrix_of(path, matrices, *names))


def matrix_of(path: Path, matrices: Mapping[str, Float], *names: str) -> Float:
    """Return the (3, 4) or (3, 3) matrix with the first of these names that the file has."""
    name = next((name for name in names if name in matrices), None)
    if name is None or matrices[name].ndim != 2:
        found = "no such line" if name is None else f"{matrices[name].size} numbers"
        raise DumpError(f"{path}: {' or '.join(names)}: expected 12 or 9 numbers, found {found}")
    return matrices[name]


def cameras_in(sequence: Path, prefix: str) -> list[int]:
    """Return the numbers of the cameras with images, such as ``image_02`` for the prefix ``image_0``, colour first."""
    return [number for pair in _PAIRS for number in pair if (sequence / f"{prefix}{number}").is_dir()]


def cameras_of(
    request: Request, prefix: str, projection: str, path: Path, matrices: Mapping[str, Float]
) -> tuple[dict[str, Sensor], dict[str, Float]]:
    """Return the sensors and projections of the front camera and its pair by role, colour first.

    ``prefix`` and ``projection`` start the names of folders and matrices. Adds notes about the other cameras.
    """
    there = cameras_in(request.path, prefix)
    pair = next(pair for pair in _PAIRS if there[0] in pair)
    used = dict(zip(("image", "right"), [number for number in pair if number in there], strict=False))
    others = sorted(set(there) - set(used.values()))
    request.notes.extend(f"{prefix}{other}/ is left out: {prefix}{there[0]} is the front camera" for other in others)
    sensors = {role: sensor_in(request.path / f"{prefix}{number}", role) for role, number in used.items()}
    return sensors, {role: matrix_of(path, matrices, f"{projection}{number}") for role, number in used.items()}


def height_of(request: Request) -> float:
    """Return the height of the cameras in metres; adds a note if it is assumed."""
    if not request.options.height_m:
        request.notes.append(f"assumed: level cameras {HEIGHT_M} m above the road, as KITTI describes its car")
    return request.options.height_m or HEIGHT_M


def kitti_rig(
    path: Path,
    projections: Mapping[str, Float],
    sensors: Mapping[str, Sensor],
    camera0_T_lidar: Float | None,
    height_m: float,
    number: int = -1,
) -> tuple[Rig, Float]:
    """Return the rig of a front camera, its pair and a lidar, and (4, 4) ego_T_camera0.

    Args:
        path: the calibration, for messages.
        projections: (3, 4) matrices by role: ``image``, and ``right`` if there is a pair.
        sensors: the sensors by role.
        camera0_T_lidar: (4, 4) transform from the lidar to rectified camera 0; None if it is unknown.
        height_m: height of the front camera, which is level above the ego origin.
        number: the frame with the size of the images, else that of most frames.
    """

    def camera(frame_id: str, role: str, baseline_m: float | None = None) -> Camera:
        width, height = sensors[role].sizes.get(number) or sensors[role].size or (0, 0)
        P = projections[role]
        if fault := pinhole_fault(width, height, P[0, 0], P[1, 1], P[0, 2], P[1, 2]):
            raise DumpError(f"{path}: {frame_id}: {fault}")
        return Camera(frame_id, width, height, P[0, 0], P[1, 1], P[0, 2], P[1, 2], baseline_m=baseline_m)

    centres = {role: _camera_centre(f"{path}: {role}", P) for role, P in projections.items()}
    ego_T_camera0 = mounting(z=height_m) @ rigid(np.eye(3), -centres["image"])
    cameras = {"calibration": camera(FRONT, "image")}
    frames = {FRONT: ego_T_camera0 @ rigid(np.eye(3), centres["image"])}
    if "right" in projections:
        baseline_m = float(centres["right"][0] - centres["image"][0])
        if baseline_m <= 0:
            raise DumpError(f"{path}: the right camera is {-baseline_m:g} m to the left of the front camera")
        cameras["right_calibration"] = camera(RIGHT, "right", baseline_m)
        frames[RIGHT] = ego_T_camera0 @ rigid(np.eye(3), centres["right"])
    if LIDAR in sensors and camera0_T_lidar is not None:
        frames[LIDAR] = ego_T_camera0 @ camera0_T_lidar
    transforms = tuple(Transform(EGO, frame, ego_T_frame) for frame, ego_T_frame in frames.items())
    return Rig(cameras, {"right": RIGHT, LIDAR: LIDAR}, transforms), ego_T_camera0


def _camera_centre(where: str, P: Float) -> Float:
    """Return the (3,) centre of a rectified camera in camera 0's frame, metres: -K^-1 p4 with P = [K | p4]."""
    if P.shape != (3, 4):
        raise DumpError(f"{where}: expected 12 numbers, found {P.size}")
    require_pinhole(where, P[:, :3])
    return -np.linalg.solve(P[:, :3], P[:, 3]).astype(np.float64)


def packet(where: str, line: str) -> Float:
    """Return the numbers of a packet: latitude and longitude in degrees, altitude in metres, roll, pitch and yaw."""
    words = line.split()
    values = numbers(where, words[:6])
    if len(words) != _PACKET or abs(values[0]) >= 90:
        raise DumpError(f"{where}: expected {_PACKET} numbers, a latitude first; found {len(words)}: {line[:60]!r}")
    return values


def poses_of(packets: Mapping[int, Float], ego_T_imu: Float) -> dict[int, Float]:
    """Return (4, 4) odom_T_ego by number; the odom frame is the ego frame of the first packet.

    Positions are those of the Mercator projection, with the scale of the first latitude. Source: A. Geiger, development
    kit of KITTI raw, ``latlonToMercator.m`` and ``convertOxtsToPose.m``.
    """
    if not packets:
        return {}
    first = packets[min(packets)]
    imu_T_ego = inverse(ego_T_imu)
    odom_T_world = ego_T_imu @ inverse(_world_T_imu(first, first))
    return {number: odom_T_world @ _world_T_imu(values, first) @ imu_T_ego for number, values in packets.items()}


def _world_T_imu(values: Float, first: Float) -> Float:
    """Return the pose in a world with x to the east, y to the north and z up, its origin at the first packet."""
    scale_m = cos(radians(first[0])) * _RADIUS_M
    north = asinh(tan(radians(values[0]))) - asinh(tan(radians(first[0])))
    position_m = (scale_m * radians(values[1] - first[1]), scale_m * north, values[2] - first[2])
    return rigid(rotation_from_rpy(*values[3:]), np.array(position_m))
