"""KITTI's calibration files, and the rig of rectified cameras and lidar that they describe.

The matrices P0 to P3 project from the frame of the rectified left grey camera (camera 0: x right, y down, z forward).
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, Float, mounting, pinhole_fault, rigid
from roadperc_stream.input.calibrations import LIDAR, Size
from roadperc_stream.input.projections import require_pinhole
from roadperc_stream.model import EGO, Transform

from ..carla_dump.json_files import numbers, pose, read_lines
from ..carla_dump.layout import Sensor, sensor_in
from ..carla_dump.survey import SensorSurvey
from ..rig import FRONT, RIGHT, Rig
from .drive import ConvertOptions

HEIGHT_M: Final = 1.65
"""Height of all cameras above the road, from KITTI's description of the car; they are level."""
PIXEL_ORIGIN: Final = "the first pixel's centre, as KITTI has it"
_PAIRS: Final = ((2, 3), (0, 1))
"""Left and right camera: colour, then grey."""
_NUMBER: Final = re.compile(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")
_SHAPES: Final = {12: (3, 4), 9: (3, 3)}


def read_matrices(path: Path) -> dict[str, Float]:
    """Return the numbers of each line ``name: numbers``, also without the colon: (3, 4), (3, 3), or flat.

    Lines without numbers, such as dates, are left out.

    Raises:
        DumpError: the file cannot be read, or a line that starts with numbers holds something else; it names the line.
    """
    found: dict[str, Float] = {}
    for at, line in enumerate(read_lines(path), 1):
        name, *words = line.replace(":", " ", 1).split() or [""]
        if words and (name.startswith(("P", "R", "T")) or all(map(_NUMBER.fullmatch, words))):
            values = numbers(f"{path}: line {at}: {name}", words)
            found[name] = values.reshape(_SHAPES.get(len(values), (-1,)))
    return found


def pose_of(path: Path, matrices: Mapping[str, Float], *names: str) -> Float:
    """Return the (4, 4) pose with the first of these names; errors as in ``matrix_of`` and ``json_files.pose``."""
    return pose(f"{path}: {' or '.join(names)}", matrix_of(path, matrices, *names))


def matrix_of(path: Path, matrices: Mapping[str, Float], *names: str) -> Float:
    """Return the (3, 4) or (3, 3) matrix with the first of these names that the file has.

    Raises:
        DumpError: the file has none of them, or it has another number of values.
    """
    name = next((name for name in names if name in matrices), None)
    if name is None or matrices[name].ndim != 2:
        found = "no such line" if name is None else f"{matrices[name].size} numbers"
        raise DumpError(f"{path}: {' or '.join(names)}: expected 12 or 9 numbers, found {found}")
    return matrices[name]


def cameras_in(sequence: Path, prefix: str) -> list[int]:
    """Return the numbers of the cameras with images, such as ``image_02`` for the prefix ``image_0``, colour first."""
    return [number for pair in _PAIRS for number in pair if (sequence / f"{prefix}{number}").is_dir()]


def cameras_of(
    sequence: Path, prefix: str, projection: str, path: Path, matrices: Mapping[str, Float], notes: list[str]
) -> tuple[dict[str, Sensor], dict[str, Float]]:
    """Return the sensors and projections of the front camera and its pair by role, colour first.

    ``prefix`` and ``projection`` start the names of folders and matrices. Adds notes about the other cameras.
    """
    there = cameras_in(sequence, prefix)
    pair = next(pair for pair in _PAIRS if there[0] in pair)
    used = dict(zip(("image", "right"), [number for number in pair if number in there], strict=False))
    others = sorted(set(there) - set(used.values()))
    notes += [f"{prefix}{number}/ is left out: {prefix}{there[0]} is the front camera" for number in others]
    sensors = {role: sensor_in(sequence / f"{prefix}{number}", role) for role, number in used.items()}
    return sensors, {role: matrix_of(path, matrices, f"{projection}{number}") for role, number in used.items()}


def height_of(options: ConvertOptions, notes: list[str]) -> float:
    """Return the height of the cameras in metres; adds a note if it is assumed."""
    assumed = f"assumed: level cameras {HEIGHT_M} m above the road, as KITTI describes its car"
    notes += [] if options.height_m else [assumed]
    return options.height_m or HEIGHT_M


def camera_centre(where: str, P: Float) -> Float:
    """Return the (3,) centre of a rectified camera in camera 0's frame, metres: -K^-1 p4 with P = [K | p4].

    Raises:
        DumpError: P is not the projection of a rectified camera; the message starts with ``where``.
    """
    if P.shape != (3, 4):
        raise DumpError(f"{where}: expected 12 numbers, found {P.size}")
    require_pinhole(where, P[:, :3])
    return -np.linalg.solve(P[:, :3], P[:, 3]).astype(np.float64)


def rig(
    path: Path,
    projections: Mapping[str, Float],
    surveys: Mapping[str, SensorSurvey],
    camera0_T_lidar: Float | None,
    height_m: float,
    number: int = -1,
) -> tuple[Rig, Float]:
    """Return the rig of a front camera, its pair and a lidar, and (4, 4) ego_T_camera0.

    Args:
        path: the calibration, for messages.
        projections: (3, 4) matrices by role: ``image``, and ``right`` if there is a pair.
        surveys: the sensors by role.
        camera0_T_lidar: (4, 4) transform from the lidar to rectified camera 0; None if it is unknown.
        height_m: height of the front camera, which is level above the ego origin.
        number: the frame with the size of the images, else that of most frames.

    Raises:
        DumpError: a matrix is not the projection of a rectified camera, or the pair has no baseline.
    """
    sizes = {role: found.sizes.get(number, found.size) for role, found in surveys.items() if found.size}
    centres = {role: camera_centre(f"{path}: {role}", P) for role, P in projections.items()}
    ego_T_camera0 = mounting(z=height_m) @ rigid(np.eye(3), -centres["image"])
    cameras = {"calibration": _camera(path, FRONT, projections["image"], sizes["image"])}
    frames = {FRONT: ego_T_camera0 @ rigid(np.eye(3), centres["image"])}
    if "right" in projections:
        baseline_m = float(centres["right"][0] - centres["image"][0])
        if baseline_m <= 0:
            raise DumpError(f"{path}: the right camera is {-baseline_m:g} m to the left of the front camera")
        cameras["right_calibration"] = _camera(path, RIGHT, projections["right"], sizes["right"], baseline_m)
        frames[RIGHT] = ego_T_camera0 @ rigid(np.eye(3), centres["right"])
    if LIDAR in surveys and camera0_T_lidar is not None:
        frames[LIDAR] = ego_T_camera0 @ camera0_T_lidar
    transforms = tuple(Transform(EGO, frame, ego_T_frame) for frame, ego_T_frame in frames.items())
    return Rig(cameras, {"right": RIGHT, LIDAR: LIDAR}, transforms), ego_T_camera0


def _camera(path: Path, frame_id: str, P: Float, size: Size, baseline_m: float | None = None) -> Camera:
    if fault := pinhole_fault(*size, P[0, 0], P[1, 1], P[0, 2], P[1, 2]):
        raise DumpError(f"{path}: {frame_id}: {fault}")
    return Camera(frame_id, *size, P[0, 0], P[1, 1], P[0, 2], P[1, 2], baseline_m=baseline_m)
