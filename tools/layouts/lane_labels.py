"""Labelled lines in pixels as true lanes, on a level road below the camera.

Datasets of lane labels do not state the camera's pitch. On a straight road all lines meet in the vanishing point, whose
median over the frames gives pitch and yaw of the mounting.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import Camera, Float, mounting, rays
from roadperc_stream.geometry.rectification import rectified, rectified_pixels
from roadperc_stream.model import EGO, SIDES, Boundary, Lanes, Transform

from ..carla_dump.calibration_file import CALIBRATION_NAME, CalibrationFile
from ..carla_dump.camera_rig import FRONT, Rig, Size, build_rig
from ..carla_dump.truth_file import NO_TRUTH, TruthTables
from .drive import ConvertOptions
from .dump import calibration_of

Lines = Sequence[Float]
"""The lines of a frame, each (N, 2) x, y in pixels."""
_FARTHEST_M: Final = 60.0
"""Beyond it a pixel is metres long."""
_SHORTEST_M: Final = 3.0
_CURVED_M: Final = 15.0
"""A shorter line is fitted without curvature."""
_WIDEST_M: Final = 5.0
"""Largest distance of a boundary of the ego lane."""
_SPREAD: Final = 0.3
"""Least difference of the lines' slopes, columns a row: lines that are nearly parallel meet nowhere."""
_WITHOUT_PITCH: Final = "the pitch of the camera is unknown, because no frame has two lines that meet"


def labelled_rig(
    folder: Path, options: ConvertOptions, size: Size | None, frames: Mapping[int, Lines]
) -> tuple[Rig, TruthTables, list[str]]:
    """Return the rig of the front camera, the true lanes by frame, and notes about the mounting.

    Args:
        folder: dataset, which may have a ``calibration.json``.
        options: options of the command line.
        size: columns and rows of the images.
        frames: labelled lines by frame number, in the recorded image.

    Raises:
        DumpError: the camera has no calibration.
    """
    calibration, path = calibration_of(folder / CALIBRATION_NAME, options)
    rig = build_rig(calibration, path, ["image"], {"image": size} if size else {})
    camera, straight = rig.cameras["calibration"], rectified(rig.cameras["calibration"])
    if straight is not camera:
        frames = {n: [rectified_pixels(camera, straight, line) for line in lines] for n, lines in frames.items()}
    ego_T_camera, notes = _mounting(rig, straight, calibration, frames.values())
    lanes = {number: true_lanes(lines, straight, ego_T_camera) for number, lines in frames.items()}
    truth = replace(NO_TRUTH, lanes={number: found for number, found in lanes.items() if found.boundaries})
    mounted = Transform(EGO, FRONT, ego_T_camera)
    return replace(rig, transforms=(mounted,)), truth, [*rig.notes, *notes]


def _mounting(
    rig: Rig, camera: Camera, calibration: CalibrationFile, frames: Iterable[Lines]
) -> tuple[Float, list[str]]:
    """Return ego_T_camera of the calibration, else of the labels and a height, and notes about them."""
    if calibration.mounting and rig.transforms:
        return rig.transforms[0].parent_T_child, []
    height_m = calibration.rgb_height_m or SurfaceConfig().assumed_height_m
    stated = "" if calibration.rgb_height_m else f"assumed: camera {height_m:g} m above the road (--height); "
    points = [point for lines in frames if (point := vanishing_point(lines)) is not None]
    if not points:
        return mounting(z=height_m), [f"{stated}{_WITHOUT_PITCH}"]
    u, v = np.median(points, axis=0)
    pitch = np.arctan((camera.cy - v) / camera.fy)
    yaw = np.arctan((u - camera.cx) / camera.fx * np.cos(pitch))
    pitch_deg, yaw_deg = float(np.degrees(pitch)), float(np.degrees(yaw))
    notes = [f"{stated}pitch {pitch_deg:.2f} and yaw {yaw_deg:.2f} degrees from the vanishing point of the labels"]
    return mounting(z=height_m, pitch=pitch_deg, yaw=yaw_deg), notes


def vanishing_point(lines: Lines) -> Float | None:
    """Return (2,) pixels of the point that is nearest to the lower halves of the lines; None if they are parallel."""
    near = [line[line[:, 1] >= np.median(line[:, 1])] for line in lines]
    fits = np.array(
        [np.polyfit(part[:, 1], part[:, 0], 1) for part in near if np.ptp(part[:, 1]) > 0] or np.empty((0, 2))
    )
    if len(fits) < 2 or np.ptp(fits[:, 0]) < _SPREAD:
        return None
    slopes, offsets = fits.T
    u, v = np.linalg.lstsq(np.column_stack((np.ones_like(slopes), -slopes)), offsets, rcond=None)[0]
    return np.array([u, v])


def true_lanes(lines: Lines, camera: Camera, ego_T_camera: Float) -> Lanes:
    """Return the nearest line on each side as a boundary of the ego lane, on the plane z = 0 of the ego frame.

    Args:
        lines: labelled lines in the rectified image.
        camera: the rectified camera.
        ego_T_camera: (4, 4) mounting.
    """
    on_road = [points for line in lines if (points := _on_road(line, camera, ego_T_camera)) is not None]
    fits = [(_fit(points), points) for points in on_road]
    boundaries = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        near = [(state, points) for state, points in fits if 0 < sign * state[0] < _WIDEST_M]
        if near:
            (offset_m, heading, curvature), points = min(near, key=lambda pair: abs(pair[0][0]))
            boundaries.append(
                Boundary(
                    side,
                    "measured",
                    offset_m=offset_m,
                    heading=heading,
                    curvature_per_m=curvature,
                    line_ego_m=points,
                )
            )
    return Lanes(tuple(boundaries))


def _on_road(line_px: Float, camera: Camera, ego_T_camera: Float) -> Float | None:
    """Return (N, 3) ego points of a line, near end first; None if it is too short."""
    directions = rays(camera, line_px) @ ego_T_camera[:3, :3].T
    down = directions[directions[:, 2] < 0]
    points = ego_T_camera[:3, 3] - down * (ego_T_camera[2, 3] / down[:, 2:])
    points = points[(points[:, 0] > 0) & (points[:, 0] < _FARTHEST_M)]
    points = points[np.unique(points[:, 0], return_index=True)[1]]
    return points if len(points) > 2 and np.ptp(points[:, 0]) > _SHORTEST_M else None


def _fit(points: Float) -> tuple[float, float, float]:
    """Return offset, heading and curvature at x = 0; a pixel is as wide as its point is far."""
    x, y = points[:, 0], points[:, 1]
    degree = 2 if np.ptp(x) > _CURVED_M and len(x) > 4 else 1
    second, first, offset = np.pad(np.polyfit(x, y, degree, w=1 / x), (2 - degree, 0))
    return float(offset), float(first), float(2 * second)
