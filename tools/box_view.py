"""What a camera sees of an upright box."""

from typing import Final

import numpy as np

from roadperc_stream.geometry import Camera, Float, project

SIDES: Final = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Corner indices around each side of a box, in the order of ``corners_between``."""


def corners_between(low: Float, high: Float) -> Float:
    """Return the (8, 3) corners of the box between two (3,) corners; bit k of an index selects ``high`` on axis k."""
    return np.array([[(low, high)[(i >> axis) & 1][axis] for axis in range(3)] for i in range(8)])


def seen_sides(camera: Camera, corners: Float, near_m: float) -> list[Float]:
    """Return the (M, 3) parts of a box's sides that are in the view, hidden ones too; empty outside the view.

    Args:
        camera: the camera.
        corners: (8, 3) corners in the camera's frame, in the order of ``corners_between``.
        near_m: the view begins here, metres along the axis.
    """
    limits = np.vstack((np.column_stack((view_limits(camera), np.zeros(4))), (0, 0, 1, -near_m)))
    parts = [_clipped(corners[list(side)], limits) for side in SIDES]
    return [part for part in parts if len(part)]


def image_box(camera: Camera, sides: list[Float]) -> tuple[int, int, int, int]:
    """Return the half-open image box of the sides of an upright box, as CARLA makes its 2D boxes.

    Source: CARLA's documentation, "Bounding boxes": the extremes of the projected vertices. The box is clipped to the
    view first. Otherwise the box of a car beside the camera would reach the top of the image.
    """
    pixels = project(camera, np.concatenate(sides))
    low, high = np.floor(pixels.min(axis=0) + 0.5), np.ceil(pixels.max(axis=0) + 0.5)
    size = np.array((camera.width, camera.height))
    (x0, y0), (x1, y1) = np.clip(low, 0, size - 1), np.clip(high, 1, size)
    return int(x0), int(y0), int(x1), int(y1)


def view_limits(camera: Camera) -> Float:
    """Return (4, 3) inward normals of the planes through the camera and the image's left, right, top and bottom."""
    x0, x1 = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    y0, y1 = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    return np.array([(1, 0, -x0), (-1, 0, x1), (0, 1, -y0), (0, -1, y1)], np.float64)


def _clipped(corners: Float, limits: Float) -> Float:
    """Return (M, 3) corners of a polygon clipped to all limits; no corners if it lies outside.

    Source: I. Sutherland and G. Hodgman, Reentrant polygon clipping, CACM 17 (1974).
    """
    for limit in limits:
        inside = corners @ limit[:3] + limit[3]
        following, next_inside = np.roll(corners, -1, axis=0), np.roll(inside, -1)
        with np.errstate(invalid="ignore", divide="ignore"):
            crossings = corners + (following - corners) * (inside / (inside - next_inside))[:, None]
        kept = np.stack((inside >= 0, (inside >= 0) != (next_inside >= 0)), axis=1)
        corners = np.stack((corners, crossings), axis=1)[kept]
    return corners
