"""Labelled lines in pixels as true lanes, on a level road below the camera.

Datasets of lane labels do not state the camera's pitch. On a straight road all lines meet in the vanishing point, whose
median over the frames gives pitch and yaw of the mounting.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import Camera, Float, mounting, rays
from roadperc_stream.geometry.rectification import is_rectified, rectified, rectified_pixels
from roadperc_stream.model import EGO, SIDES, Boundary, Lanes, Transform

from ..readers.sensor_folders import Sensor, with_headers
from ..readers.truth_file import TruthTables
from ..rig import FRONT, build_rig
from .dataset import DatasetSequence, Request

FLAGS: Final = ("--sequence", "--fov", "--calibration", "--height")
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
"""Least difference of the lines' slopes, columns a row: nearly parallel lines have no certain vanishing point."""


def labelled_dataset(
    request: Request, images: Sensor, lines_px: Mapping[int, Lines], stamps_ns: Mapping[int, int]
) -> DatasetSequence:
    """Return the images of the front camera with the true lanes of the labelled ones.

    Args:
        request: its folder may have a ``calibration.json``.
        images: images by number.
        lines_px: labelled lines by number, in the recorded image.
        stamps_ns: stamp by number.

    Raises:
        DumpError: the camera has no calibration, or no image can be read.
    """
    sensors = with_headers({"image": images})
    calibration, path = request.options.calibration_of(request.folder)
    rig = build_rig(calibration, path, ["image"], {role: found.size for role, found in sensors.items() if found.size})
    request.notes.extend(rig.notes)
    recorded = rig.cameras["calibration"]
    camera = rectified(recorded)
    if not is_rectified(recorded):
        lines_px = {k: [rectified_pixels(recorded, camera, line) for line in lines] for k, lines in lines_px.items()}
    if calibration.mounting and rig.transforms:
        ego_T_camera = rig.transforms[0].parent_T_child
    else:
        ego_T_camera, note = _mounting(camera, calibration.rgb_height_m, lines_px.values())
        request.notes.append(note)
    rig = replace(rig, transforms=(Transform(EGO, FRONT, ego_T_camera),))
    lanes = {number: true_lanes(lines, camera, ego_T_camera) for number, lines in lines_px.items()}
    truth = TruthTables(lanes={number: found for number, found in lanes.items() if found.boundaries})
    return DatasetSequence("", sensors, stamps_ns, "", rig, truth=truth)


def _mounting(camera: Camera, height_m: float | None, frames: Iterable[Lines]) -> tuple[Float, str]:
    """Return ego_T_camera of a height and the labels, and a note about it."""
    points = [point for lines in frames if (point := vanishing_point(lines)) is not None]
    u, v = np.median(points, axis=0) if points else (camera.cx, camera.cy)
    pitch = np.arctan((camera.cy - v) / camera.fy)
    pitch_deg = float(np.degrees(pitch))
    yaw_deg = float(np.degrees(np.arctan((u - camera.cx) / camera.fx * np.cos(pitch))))
    z = height_m or SurfaceConfig().assumed_height_m
    angles = f"pitch {pitch_deg:.2f} and yaw {yaw_deg:.2f} degrees from the vanishing point of the labels"
    note = f"{'' if height_m else 'assumed: '}camera {z:g} m above the road; {angles if points else 'level (assumed)'}"
    return mounting(z=z, pitch=pitch_deg, yaw=yaw_deg), note


def vanishing_point(lines: Lines) -> Float | None:
    """Return (2,) pixels of the point that is nearest to the lower halves of the lines; None if they are parallel."""
    near = [line[line[:, 1] >= np.median(line[:, 1])] for line in lines]
    fits = [np.polyfit(half[:, 1], half[:, 0], 1) for half in near if np.ptp(half[:, 1]) > 0]
    slopes, offsets = np.reshape(fits, (-1, 2)).T
    if len(fits) < 2 or np.ptp(slopes) < _SPREAD:
        return None
    return np.asarray(np.linalg.lstsq(np.column_stack((slopes**0, -slopes)), offsets, rcond=None)[0], np.float64)


def true_lanes(lines: Lines, camera: Camera, ego_T_camera: Float) -> Lanes:
    """Return the nearest line on each side as a boundary of the ego lane, on the plane z = 0 of the ego frame.

    ``camera`` and the lines are those of the rectified image.
    """
    on_road = [points for line in lines if (points := _on_road(line, camera, ego_T_camera)) is not None]
    fits = sorted(((_fit(points), points) for points in on_road), key=lambda pair: abs(pair[0][0]))
    found = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        near = [pair for pair in fits if 0 < sign * pair[0][0] < _WIDEST_M]
        found += [Boundary(side, "measured", None, None, *state, line_ego_m=points) for state, points in near[:1]]
    return Lanes(tuple(found))


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
