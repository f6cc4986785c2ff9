"""Small planes around features: depth and slope of the surface that a feature lies on.

On a plane 1 / depth is linear in the image. Fitting it to the pixels around a feature averages the depth's noise, and
its slope determines how the surroundings are stretched when the camera moves. On a road at a grazing angle, windows
compared without that stretch are matched with a bias: steps came out 1 to 2 % short.
"""

import numpy as np

from roadperc_stream.core.geometry import Camera, Float, Float32, Plane, project, rays, transform

_REACH_PX = 3
_SAME_SURFACE = 0.15
"""Relative difference of depth up to which a neighbouring pixel belongs to the feature's own surface."""
_MIN_PIXELS = 6
_HALF_PIXELS = np.array(((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)))
"""To the right, left, down and up, between which a picture is stretched."""
_RIDGE = 1e-9
"""Keeps the normal equations of pixels in one line solvable: their slope across is then none."""


def local_planes_from_depth(depth_m: Float32, px: Float, shrink: int) -> tuple[Float, Float]:
    """Inverse depths and their slopes, by least squares over the pixels around that belong to the same surface.

    Args:
        depth_m: (H, W) metres, NaN unknown.
        px: (N, 2) features in an image ``shrink`` times smaller.
        shrink: how much smaller.

    Returns:
        (N,) inverse depths at the features in 1/m, and (N, 2) their change per pixel of the smaller image to the right
        and down; NaN unknown.
    """
    rows, columns = depth_m.shape
    full = px * shrink + (shrink - 1) / 2
    centre = np.floor(px + 0.5).astype(int) * shrink
    dv, du = (d.ravel() for d in np.mgrid[-_REACH_PX : _REACH_PX + 1, -_REACH_PX : _REACH_PX + 1])
    u, v = np.clip(centre[:, :1] + du, 0, columns - 1), np.clip(centre[:, 1:] + dv, 0, rows - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = 1.0 / depth_m[v, u].astype(float)
        middle = rho[:, len(du) // 2, None]
        same = np.abs(rho - middle) < _SAME_SURFACE * middle
    A = np.stack((np.ones_like(rho), u - full[:, :1], v - full[:, 1:]), axis=-1) * same[..., None]
    At = A.transpose(0, 2, 1)
    fit = np.linalg.solve(At @ A + _RIDGE * np.eye(3), At @ np.where(same, rho, 0.0)[..., None])[..., 0]
    fit[np.sum(same, axis=1) < _MIN_PIXELS] = np.nan
    return fit[:, 0], fit[:, 1:] * shrink


def slope_of_plane(camera: Camera, plane: Plane) -> Float:
    """(2,) change of 1 / depth per pixel to the right and down, the same all over a plane in the camera's frame."""
    nx, ny, _ = plane.normal
    return np.array((nx / camera.fx, ny / camera.fy)) / -plane.offset_m


def stretch(camera: Camera, px: Float, depth_m: Float, slope: Float, this_T_key: Float) -> Float:
    """(N, 2, 2) derivative of the pixel in another frame by the pixel around a feature.

    Args:
        camera: of both frames.
        px: (N, 2) features in the keyframe.
        depth_m: (N,) their depth.
        slope: (N, 2) as ``local_planes_from_depth`` gives it.
        this_T_key: the motion.
    """
    points = rays(camera, px + _HALF_PIXELS[:, None]) / (1.0 / depth_m + _HALF_PIXELS @ slope.T)[..., None]
    right, left, below, above = project(camera, transform(this_T_key, points))
    return np.stack((right - left, below - above), axis=-1)
