"""Registration of sensors: depth and labels between two cameras, and lidar points in an image."""

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32, project, transform, unproject
from roadperc_stream.geometry.arrays import Image, Mask

Index = NDArray[np.int64]


def sample_labels(
    depth_camera: Camera, camera_T_depth: Float, camera: Camera, depth_m: Float32, labels: Image
) -> Image:
    """Another camera's labels at the pixels of a depth image: each depth pixel samples its point in the other image.

    ``depth_m`` (H, W) are metres, NaN unknown; ``labels`` (h, w) are uint8. ``camera_T_depth`` is the pose of the
    depth's camera.

    Returns:
        (H, W) uint8; 0 where the depth is unknown or the point lies outside the other image.
    """
    columns, rows, _, inside = _projected(depth_camera, camera_T_depth, camera, depth_m)
    sampled = np.zeros(depth_m.shape, np.uint8)
    sampled[inside] = labels[rows, columns]
    return sampled


def warp_depth(depth_camera: Camera, camera_T_depth: Float, camera: Camera, depth_m: Float32) -> Float32:
    """Depth in another camera's image: each point goes to its nearest pixel, and the nearest point of a pixel wins.

    Args and units as in ``sample_labels``.

    Returns:
        (h, w) float32 metres along the other camera's z, NaN where no point falls.
    """
    columns, rows, z, _ = _projected(depth_camera, camera_T_depth, camera, depth_m)
    warped = np.full(camera.size, np.inf, np.float32)
    order = np.argsort(-z, kind="stable")
    columns, rows, z = columns[order], rows[order], z[order].astype(np.float32)
    warped[rows, columns] = z
    _fill_gaps(warped)
    warped[np.isinf(warped)] = np.nan
    return warped


def depth_of_points(camera: Camera, camera_T_lidar: Float, points_m: Float32) -> Float32:
    """Sparse depth of lidar points in a camera's image; the nearest point of a pixel counts.

    The projection is that of a pinhole camera, even if the camera has a lens. A pixel and its depth thus give the point
    again, to within half a pixel. ``points_m`` are (N, 3) in the lidar's frame; those behind the camera and outside its
    image are left out.

    Returns:
        (h, w) float32 metres along the camera's z, NaN where no point falls.
    """
    points = transform(camera_T_lidar, points_m.astype(np.float64))
    columns, rows = np.rint(project(camera, points)).T
    with np.errstate(invalid="ignore", over="ignore"):
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        z = points[inside, 2].astype(np.float32)
    depth_m = np.full(camera.height * camera.width, np.inf, np.float32)
    np.minimum.at(depth_m, (rows * camera.width + columns)[inside].astype(np.int64), z)
    depth_m[np.isinf(depth_m)] = np.nan
    return depth_m.reshape(camera.size)


def _projected(
    depth_camera: Camera, camera_T_depth: Float, camera: Camera, depth_m: Float32
) -> tuple[Index, Index, Float, Mask]:
    """Column, row and z in the other camera of the depth pixels visible in it, and which (H, W) pixels those are."""
    rows, columns = np.indices(depth_m.shape, dtype=float)
    points = transform(camera_T_depth, unproject(depth_camera, np.stack((columns, rows), axis=-1), depth_m))
    pixels = np.rint(project(camera, points))
    with np.errstate(invalid="ignore"):
        inside: Mask = np.asarray(((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=-1))
    visible = pixels[inside].astype(np.int64)
    return visible[:, 0], visible[:, 1], points[inside][:, 2], inside


def _fill_gaps(depth_m: Float32) -> None:
    """Give empty pixels between two rows or columns of points the farther neighbour's depth, in place.

    A surface that appears larger than before leaves lines of empty pixels one wide; the farther neighbour never
    invents an object in front.
    """
    for axis in (0, 1):
        before, after = np.roll(depth_m, 1, axis), np.roll(depth_m, -1, axis)
        between = np.isinf(depth_m) & np.isfinite(before) & np.isfinite(after)
        depth_m[between] = np.maximum(before, after)[between]
