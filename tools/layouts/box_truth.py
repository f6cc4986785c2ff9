"""True objects from 3D boxes: the distance to the nearest point of a box that the camera can see."""

import numpy as np
from scipy.optimize import nnls

from roadperc_stream.geometry import Camera, Float

from ..box_view import view_limits


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
    limits = view_limits(camera)
    inside = _nearest_m(np.vstack((sides, limits)), np.concatenate((bounds, np.zeros(len(limits)))))
    return _nearest_m(sides, bounds) if np.isnan(inside) else inside


def _nearest_m(normals: Float, bounds: Float) -> float:
    """Return the least norm of points with ``normals @ point >= bounds``, or NaN if there is no such point."""
    system = np.vstack((normals.T, bounds))
    weights, residual = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))
    *beside, last = system @ weights - (0.0, 0.0, 0.0, 1.0)
    return float("nan") if residual < 1e-9 else float(np.linalg.norm(beside) / -last)
