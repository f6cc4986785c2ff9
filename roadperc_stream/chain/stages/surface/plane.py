"""A plane through the road's points, the pixels near it, and the evidence that the road leaves it.

Method: RANSAC (Fischler and Bolles 1981) over a seeded subsample, hypotheses from three points evaluated in batches,
then total least squares over all inliers. The road plane is nearly parallel to the optical axis, so the fit minimises
the distance to the plane, never an error along one axis.

The road near the car is cut into patches, and the median height of each one's cells over the plane is compared with
two errors: its own, by which chance alone would lift it, and that of a height field fitted to the same cells. The
field follows the road everywhere, but its coefficients cost accuracy in proportion to the cells' scatter; the plane
has next to none of that error and all of the bias (Mallows 1973). So the field pays where patches lie off the plane by
more than both: on roads that climb, and where noise has tilted the plane itself.
"""

import math
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.kernels import mark_near, marked, moments_near
from roadperc_stream.chain.kernels.surface_plain import PlaneDistances
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import (
    Camera,
    Float,
    Float32,
    Plane,
    distance_per_depth,
    facing,
    fit_plane,
    plane_of_scatter,
)
from roadperc_stream.model import Absent, Mask, Reason

_LOWER_IMAGE = 0.6
"""Rows below this share of the image show the road in front of the car, where there is no segmentation."""
_ONE_PLACE_M = 1e-6
"""Root mean square distance of points from their centroid that is as good as none: then an upright plane fits, too."""
_CAMERA_CENTRE = np.zeros(3)
_COLLINEAR = 1e-3
"""Sine of the angle between two sides of a triangle below which its three points count as a line."""
_BATCH: Final = 32
"""Planes tried at once: enough for one matrix product, few enough to stop soon after a good one."""
_SUBSAMPLE: Final = 2048
"""Points that planes are tried on: the share of inliers is known to 1 %, and the refit takes all points."""
_ENOUGH_INLIERS: Final = 0.95
"""Share of inliers at which no further planes are tried: more cannot win by much."""
_MIN_INLIERS: Final = 0.2
"""Share of inliers below which there is no plane: noise and clutter alone reach less."""
_PATCH_M: Final = 5.0
"""Length of a patch; there is one on either side of the ego x axis."""
_REACH_M: Final = 40.0
"""Patches farther ahead hold few points, of a road that is seen at a grazing angle."""
_HALF_WIDTH_M: Final = 4.0
_MIN_CELLS: Final = 5
_STDS: Final = 2.0
_MEDIAN_STD: Final = 1.25
"""Standard error of a median of many normal errors over that of their mean."""
NORMAL_MAD: Final = 1.4826
"""Standard deviation of normal errors over their median absolute one."""
_FIELD_STD: Final = 0.25
"""Error of a height field over the standard deviation of the cells' heights, measured on rendered roads."""
_FINEST_M: Final = 0.0005
"""Height for which no field is worth its time."""
_SHARE: Final = 0.2
"""Share of the patches that must lie off the plane."""


def usable_pixels(cfg: SurfaceConfig, camera: Camera, depth_m: Float32, drivable: Mask | None) -> Mask:
    """Pixels that may belong to the road and whose depth is known (a comparison with NaN is False)."""
    top = int(camera.height * _LOWER_IMAGE) if drivable is None else first_row(drivable)
    usable = np.zeros(camera.size, bool)
    among = np.ones(camera.size, bool) if drivable is None else drivable
    with np.errstate(invalid="ignore"):
        np.logical_and(among[top:], depth_m[top:] < np.float32(cfg.max_depth_m), out=usable[top:])
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
    marks = among[top:].view(np.uint8), near[top:].view(np.uint8)
    mark_near(depth_m[top:], _distances(camera, plane, top), within_m, *marks)
    return near


def plane_near(camera: Camera, depth_m: Float32, plane: Plane, within_m: float, among: Mask) -> Plane | None:
    """The plane through the points of the same pixels; None where these are fewer than three.

    Total least squares as ``fit_plane``, but of sums row by row: the points, which are many, are never stored.
    """
    top, (x, y) = first_row(among), ray_parts(camera)
    distances = _distances(camera, plane, top)
    sums = moments_near(depth_m[top:], distances, within_m, among[top:].view(np.uint8), x)
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


def _distances(camera: Camera, plane: Plane, top: int) -> PlaneDistances:
    """Of the pixels from row ``top`` down."""
    column, row = distance_per_depth(camera, plane)
    return PlaneDistances(column, row[top:], plane.offset_m)


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


def road_plane(
    cfg: SurfaceConfig, camera: Camera, depth_m: Float32, usable: Mask, up: Float, rng: np.random.Generator
) -> tuple[Plane, float] | Absent:
    """The plane most of the road's points lie on, facing the camera, and the share of them that do.

    Args:
        cfg: thresholds.
        camera: of the depth.
        depth_m: (H, W) metres.
        usable: (H, W) pixels of the road with known depth.
        up: (3,) roughly away from the road in the camera's frame, unit length.
        rng: source of the hypotheses.
    """
    count = int(np.count_nonzero(usable))
    if count < 3:
        return Absent(Reason("surface", "too_few_road_points", (count,)))
    chosen = rng.integers(0, count, min(_SUBSAMPLE, count))
    sample = points_of(camera, depth_m, marked(usable.view(np.uint8), chosen))
    plane = _ransac(cfg, sample, up, rng)
    if plane is None:
        return Absent(Reason("surface", "no_plane", (count, _MIN_INLIERS)))
    # Refitting to the sample is cheap, and leaves one pass over all points to do.
    close = np.abs(plane.distance(sample)) <= cfg.inlier_m
    refitted = None
    if np.count_nonzero(close) >= 3:
        refitted = plane_near(camera, depth_m, fit_plane(sample, close), cfg.inlier_m, usable)
    if refitted is None:
        return Absent(Reason("surface", "plane_without_points"))
    plane = facing(refitted, _CAMERA_CENTRE)
    # The refit may turn a hypothesis that was level: of points that all lie within ``inlier_m`` it includes every one.
    tilt_deg = float(np.degrees(np.arccos(min(abs(float(plane.n @ up)), 1.0))))
    if tilt_deg <= cfg.max_tilt_deg and plane.n @ up < 0:  # level, but above the camera: what wrong tags take for road
        tilt_deg = 180.0 - tilt_deg
    if not tilt_deg <= cfg.max_tilt_deg:
        return Absent(Reason("surface", "plane_tilted", (tilt_deg, cfg.max_tilt_deg)))
    inliers = pixels_near(camera, depth_m, plane, cfg.inlier_m, usable)
    return plane, int(np.count_nonzero(inliers)) / count


def _ransac(cfg: SurfaceConfig, points: Float, up: Float, rng: np.random.Generator) -> Plane | None:
    """The hypothesis that most points support; None where none is supported enough."""
    best, best_share = None, _MIN_INLIERS
    for tried in range(0, cfg.hypotheses, _BATCH):
        if best_share >= _ENOUGH_INLIERS:
            break
        normals, offsets = _hypotheses(points, up, cfg.max_tilt_deg, min(_BATCH, cfg.hypotheses - tried), rng)
        if not len(normals):
            continue
        shares = np.count_nonzero(np.abs(points @ normals.T + offsets) <= cfg.inlier_m, axis=0) / len(points)
        top = int(np.argmax(shares))
        if shares[top] > best_share:
            best, best_share = Plane.of(normals[top], float(offsets[top])), float(shares[top])
    return best


def _hypotheses(
    points: Float, up: Float, max_tilt_deg: float, count: int, rng: np.random.Generator
) -> tuple[Float, Float]:
    """Normals (M, 3), pointing up, and offsets (M,) of planes through three points that are no line and no wall."""
    a, b, c = np.moveaxis(points[rng.integers(0, len(points), (count, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    sides = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    proper = lengths > _COLLINEAR * sides
    normals = normals[proper] / lengths[proper, None]
    cosines = normals @ up
    normals *= np.where(cosines < 0, -1.0, 1.0)[:, None]
    level = np.abs(cosines) >= np.cos(np.radians(max_tilt_deg))
    normals = normals[level]
    return normals, -np.sum(normals * a[proper][level], axis=1)


def leaves_plane(cells: Float) -> bool:
    """Whether a road lies off its plane by more than a height field would be wrong.

    Args:
        cells: (N, 3) x ahead, y to the left and height above the plane of the road's cells, metres.
    """
    off = [_lies_off(heights) for heights in _patches(cells) if len(heights) >= _MIN_CELLS]
    return bool(off) and sum(off) >= _SHARE * len(off)


def median(values: Float) -> float:
    """Median of (N,) numbers, N > 0: numpy's own takes many times as long for a few hundred."""
    ordered, middle = np.sort(values), len(values) // 2
    return float(ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2)


def _lies_off(heights: Float) -> bool:
    """Whether (N,) heights of a patch are off by more than chance and a field's own error."""
    middle = median(heights)
    std = NORMAL_MAD * median(np.abs(heights - middle))
    by_chance = _STDS * _MEDIAN_STD * std / math.sqrt(len(heights))
    return abs(middle) > max(by_chance, _FIELD_STD * std, _FINEST_M)


def _patches(cells: Float) -> list[Float]:
    """The heights of each patch's cells."""
    x, y, heights = cells[(cells[:, 0] < _REACH_M) & (np.abs(cells[:, 1]) < _HALF_WIDTH_M)].T
    patch = 2 * (x // _PATCH_M) + (y > 0)
    order = np.argsort(patch, kind="stable")
    _, first = np.unique(patch[order], return_index=True)
    return np.split(heights[order], first[1:])
