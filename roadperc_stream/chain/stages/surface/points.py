"""The road's pixels of a depth image, those near a plane, and their points."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.config import SurfaceConfig
from roadperc_stream.core.datatypes import Mask
from roadperc_stream.core.geometry import Camera, Float, Float32, Plane, distance_per_depth, plane_of_scatter
from roadperc_stream.core.kernels.plane_pixels import count_near, mark_known, mark_near, moments_near

_LOWER_IMAGE = 0.6
"""Rows below this share of the image show the road in front of the car, where there is no segmentation."""
_ONE_PLACE_M = 1e-6
"""Root mean square distance of points from their centroid that is as good as none: then an upright plane fits, too."""


def usable_pixels(cfg: SurfaceConfig, camera: Camera, depth_m: Float32, drivable: Mask | None) -> Mask:
    """Pixels that may belong to the road and whose depth is known (a comparison with NaN is False)."""
    top = int(camera.height * _LOWER_IMAGE) if drivable is None else first_row(drivable)
    usable = np.zeros(camera.size, bool)
    among = np.ones(camera.size, bool) if drivable is None else np.ascontiguousarray(drivable)
    mark_known(depth_m[top:], cfg.max_depth_m, among[top:].view(np.uint8), usable[top:].view(np.uint8))
    return usable


def points_of(camera: Camera, depth_m: Float32, pixels: NDArray[np.intp]) -> Float:
    """(N, 3) points in the camera frame of pixels, counted row by row; in single precision as the depth."""
    x, y = ray_parts(camera)
    rows, columns = np.divmod(pixels, camera.width)
    z = depth_m[rows, columns]
    return np.stack((x[columns] * z, y[rows] * z, z), axis=-1).astype(float)


def pixels_near(camera: Camera, depth_m: Float32, plane: Plane, within_m: float, among: Mask) -> Mask:
    """Which pixels of a mask lie within a distance of a plane; none of unknown depth.

    Args:
        camera: of the depth.
        depth_m: (H, W).
        plane: in the camera's frame.
        within_m: the distance, either side.
        among: (H, W).
    """
    top, near = first_row(among), np.zeros(camera.size, bool)
    column, row = distance_per_depth(camera, plane)
    marks = among[top:].view(np.uint8), near[top:].view(np.uint8)
    mark_near(depth_m[top:], column, row[top:], plane.offset_m, within_m, *marks)
    return near


def count_of_pixels_near(camera: Camera, depth_m: Float32, plane: Plane, within_m: float, among: Mask) -> int:
    """How many the same pixels are."""
    top = first_row(among)
    column, row = distance_per_depth(camera, plane)
    return count_near(depth_m[top:], column, row[top:], plane.offset_m, within_m, among[top:].view(np.uint8))


def plane_near(camera: Camera, depth_m: Float32, plane: Plane, within_m: float, among: Mask) -> Plane | None:
    """The plane through the points of the same pixels; None where these are fewer than three.

    Total least squares as ``fit_plane``, but of sums row by row: the points, which are many, are never stored.
    """
    top, (x, y) = first_row(among), ray_parts(camera)
    column, row = distance_per_depth(camera, plane)
    sums = moments_near(depth_m[top:], column, row[top:], plane.offset_m, within_m, among[top:].view(np.uint8), x)
    one, z, x, zz, xz, xx = sums.T
    y = y[top:].astype(float)
    count = float(one.sum())
    if count < 3:
        return None
    centroid = np.array([x.sum(), y @ z, z.sum()]) / count
    lower = [[xx.sum(), 0.0, 0.0], [y @ xz, (y * y) @ zz, 0.0], [xz.sum(), y @ zz, zz.sum()]]
    scatter = np.array(lower) / count - np.outer(centroid, centroid)
    if np.trace(scatter) <= _ONE_PLACE_M**2:
        scatter = np.zeros((3, 3))
    return plane_of_scatter(centroid, scatter)


@lru_cache(maxsize=4)
def ray_parts(camera: Camera) -> tuple[Float32, Float32]:
    """(W,) x of every column's rays with z = 1, and (H,) y of every row's."""
    x = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)
    return x, y


def first_row(mask: Mask) -> int:
    """The first row in which a mask is set; the last one where none is."""
    first = int(mask.argmax())  # which looks no further than the first one
    return first // mask.shape[1] if mask.flat[first] else len(mask) - 1
