"""True objects from 3D boxes: the distance to the nearest point of a box that the camera can see."""

import numpy as np
from scipy.optimize import nnls

from roadperc_stream.geometry import Camera, Float

_INFEASIBLE = 1e-9


def box_distance_m(camera: Camera, camera_T_box: Float, size_m: Float) -> float:
    """Return the straight-line distance from the camera to the nearest point of a box inside the image's limits.

    A box outside the view counts as a whole. Source: C. Lawson and R. Hanson, Solving Least Squares Problems (1974),
    chapter 23: the point of least norm under linear inequalities is a nonnegative least squares problem.

    Args:
        camera: the camera; only its size and matrix are used.
        camera_T_box: (4, 4) pose of the box's centre in the camera's optical frame.
        size_m: (3,) lengths along the box's axes.
    """
    axes = camera_T_box[:3, :3].T
    middle = axes @ camera_T_box[:3, 3]
    sides = np.vstack((axes, -axes))
    bounds = np.concatenate((middle - size_m / 2, -middle - size_m / 2))
    limits = _view_limits(camera)
    point = _nearest(np.vstack((sides, limits)), np.concatenate((bounds, np.zeros(len(limits)))))
    if point is None:
        point = _nearest(sides, bounds)
    return float(np.linalg.norm(camera_T_box[:3, 3] if point is None else point))


def _nearest(normals: Float, bounds: Float) -> Float | None:
    """Return the (3,) point of least norm with ``normals @ point >= bounds``, or None if there is no such point."""
    system = np.vstack((normals.T, bounds))
    target = np.array([0.0, 0.0, 0.0, 1.0])
    weights, _ = nnls(system, target)
    residual: Float = system @ weights - target
    return None if np.linalg.norm(residual) < _INFEASIBLE else -residual[:3] / residual[3]


def _view_limits(camera: Camera) -> Float:
    """Return (4, 3) inward normals of the planes through the camera and the image's left, right, top and bottom."""
    left, right = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    top, bottom = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    return np.array([(1, 0, -left), (-1, 0, right), (0, 1, -top), (0, -1, bottom)], np.float64)
