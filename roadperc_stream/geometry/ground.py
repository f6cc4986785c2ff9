"""Heights of the road below the car and intersections with rays, for a plane or a height field. Pure functions.

A ``Surface`` with a height grid is a field z(x, y) in the ego frame: bilinear between the grid's nodes, extrapolated
linearly beyond them. Without a grid the surface is its plane.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from roadperc_stream.geometry.arrays import Float, Float32
from roadperc_stream.geometry.cameras import Camera, rays
from roadperc_stream.geometry.planes import HeightGrid, Plane, Surface, intersect_plane
from roadperc_stream.geometry.rotations import transform
from roadperc_stream.kernels.occupancy_plain import Rays

REACH_M: Final = 200.0
"""Largest depth at which a ray may meet the height field; it limits the extrapolation beyond the grid."""
_TRIED_M: Final = np.geomspace(0.5, REACH_M, 25)
"""Depths at which a ray is first tested against the road."""
_PARTS: Final = np.linspace(0.0, 1.0, 5)
_REFINEMENTS: Final = 2
"""Subdivisions of the interval in which a ray crosses the road; after the second, linear interpolation suffices."""
_GRIDS_AT_ONCE: Final = 4
"""Cached height fields: the estimate and the truth of a frame and of the previous one."""
_LOOKUP_X_M: Final = (-20.0, REACH_M)
_LOOKUP_Y_M: Final = (-80.0, 80.0)


def tilted_ground(ego_T_camera: Float, pitch: float) -> Plane:
    """The road in the ego frame if the camera looks down by ``pitch`` radians more than its mounting, at its height."""
    normal = np.array([0.0 - np.sin(pitch), 0.0, np.cos(pitch)])
    centre = ego_T_camera[:3, 3]
    return Plane.of(normal, float(centre[2] - normal @ centre))


def height_at(surface: Surface, x: Float, y: Float) -> Float:
    """Height z of the road in metres at x and y, arrays of one shape, ego frame."""
    if surface.height_grid is not None:
        return _grid_height(surface.height_grid, x, y)
    a, b, d = surface.abd
    result: Float = d - a * x - b * y
    return result


def ground_points(surface: Surface, camera: Camera, ego_T_camera: Float, pixels: Float) -> Float:
    """(N, 3) ego points where the rays of (N, 2) pixels first meet the road, NaN for rays that miss it.

    The plane of ``surface`` must be in the frame of ``camera``.
    """
    if surface.height_grid is None:
        return transform(ego_T_camera, intersect_plane(camera, pixels, surface.plane))
    centre, directions = ego_T_camera[:3, 3], rays(camera, pixels) @ ego_T_camera[:3, :3].T
    points: Float = centre + directions * _first_meeting(surface.height_grid, centre, directions)[:, None]
    return points


def ego_points(camera: Camera, ego_T_camera: Float, depth_m: Float32, top: int = 0) -> tuple[Float32, Float32, Float32]:
    """Ego x, y and z in metres of depth pixels, each (h, W); NaN where the depth is unknown.

    ``depth_m`` are (h, W) rows of the camera's image, from row ``top`` on.
    """
    column, row, start_m = ego_rays(camera, ego_T_camera, top, len(depth_m))
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = ((row[k, :, None] + column[k]) * depth_m + start_m[k] for k in range(3))
    return x, y, z


def ego_rays(camera: Camera, ego_T_camera: Float, top: int, rows: int) -> Rays:
    """The rays of ``rows`` image rows from row ``top`` on, in the ego frame."""
    rotation = ego_T_camera[:3, :3]
    column = (np.arange(camera.width) - camera.cx) / camera.fx
    row = (np.arange(top, top + rows) - camera.cy) / camera.fy
    parts = np.outer(rotation[:, 0], column), rotation[:, 1:2] * row + rotation[:, 2:]
    return Rays(*(part.astype(np.float32) for part in (*parts, ego_T_camera[:3, 3])))


def height_above(surface: Surface, x: Float32, y: Float32, z: Float32) -> Float32:
    """(H, W) metres by which ego points stand above the road, measured vertically; NaN where they are unknown.

    For whole images: a height field is sampled to 1/32 of its step, 2 mm on a slope of 10 %, and is unknown far
    away from the car.
    """
    if surface.height_grid is None:
        a, b, d = (np.float32(value) for value in surface.abd)
        result: Float32 = z - (d - a * x - b * y)
        return result
    step = surface.height_grid.step_m
    columns = (x - np.float32(_LOOKUP_X_M[0])) * np.float32(1 / step)
    rows = (y - np.float32(_LOOKUP_Y_M[0])) * np.float32(1 / step)
    road = cv2.remap(
        _lookup(surface.height_grid),
        columns,
        rows,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,
    )
    return np.asarray(z - road, np.float32)


@lru_cache(maxsize=8)
def part(camera: Camera, rows: int, columns: int) -> Camera:
    """The camera of the image ``pixels[::rows, ::columns]``."""
    return replace(
        camera,
        width=-(-camera.width // columns),
        height=-(-camera.height // rows),
        fx=camera.fx / columns,
        fy=camera.fy / rows,
        cx=camera.cx / columns,
        cy=camera.cy / rows,
    )


def _grid_height(grid: HeightGrid, x: Float, y: Float) -> Float:
    """Height at x and y: bilinear inside the grid; outside, the slopes of the nearest cell's edge without its twist.

    The shapes of x and y must be equal or broadcast.
    """
    cells = _cells(grid)
    _, rows, columns = cells.shape
    u, v = (np.asarray(x) - grid.x_min_m) / grid.step_m, (np.asarray(y) - grid.y_min_m) / grid.step_m
    i = np.fmin(np.fmax(u, 0), columns - 1).astype(np.intp)  # fmax and fmin replace NaN by a number
    j = np.fmin(np.fmax(v, 0), rows - 1).astype(np.intp)
    corner, along, across, twist = (number.take(j * columns + i) for number in cells)
    u, v = u - i, v - j
    inside_u, inside_v = np.clip(u, 0, 1), np.clip(v, 0, 1)
    result: Float = corner + along * u + across * v + twist * (u * inside_v + inside_u * (v - inside_v))
    return result


@lru_cache(maxsize=_GRIDS_AT_ONCE)
def _lookup(grid: HeightGrid) -> Float32:
    """(R, C) heights sampled at the grid's step over ``_LOOKUP_X_M`` and ``_LOOKUP_Y_M``, far beyond the grid."""
    x, y = (np.arange(*reach_m, grid.step_m) for reach_m in (_LOOKUP_X_M, _LOOKUP_Y_M))
    return _grid_height(grid, x, y[:, None]).astype(np.float32)


@lru_cache(maxsize=_GRIDS_AT_ONCE)
def _cells(grid: HeightGrid) -> Float:
    """(4, rows, columns) per cell between four nodes: height, and its rise per step along x, along y and along both."""
    z = grid.z_m.astype(np.float64)
    z = np.pad(z, [(0, int(length == 1)) for length in z.shape], mode="edge")
    along, across = np.diff(z, axis=1), np.diff(z, axis=0)
    return np.stack((z[:-1, :-1], along[:-1], across[:, :-1], np.diff(along, axis=0)))


def _first_meeting(grid: HeightGrid, centre: Float, directions: Float) -> Float:
    """(N,) depths at which rays from a (3,) centre first cross the height field, NaN for rays that do not.

    A crest hides the road behind it, so the first crossing counts. Newton's method might find a later one.
    """
    depth: Float = np.broadcast_to(_TRIED_M, (len(directions), len(_TRIED_M)))
    near, far, above_m, below_m = _first_dip(grid, centre, directions, depth)
    for _ in range(_REFINEMENTS):
        depth = near[:, None] * (1.0 - _PARTS) + far[:, None] * _PARTS
        near, far, above_m, below_m = _first_dip(grid, centre, directions, depth)
    result: Float = near + (far - near) * above_m / (above_m - below_m)
    return result


def _first_dip(grid: HeightGrid, centre: Float, directions: Float, depth: Float) -> tuple[Float, Float, Float, Float]:
    """The two of (N, M) depths between which each ray first crosses the field, and its heights above the field there.

    All are (N,). The depths are NaN for rays that never cross it or start below it.
    """
    x, y, z = (start + direction[:, None] * depth for start, direction in zip(centre, directions.T, strict=True))
    gap = z - _grid_height(grid, x, y)
    below = gap <= 0
    first = below.argmax(axis=1)
    met = first > 0
    every, first = np.arange(len(gap)), np.maximum(first, 1)
    near, far = (np.where(met, depth[every, at], np.nan) for at in (first - 1, first))
    return near, far, gap[every, first - 1], gap[every, first]
