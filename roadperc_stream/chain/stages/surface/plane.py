"""A plane through the road's points, the pixels near it, and the evidence that the road leaves it.

Method: RANSAC (Fischler and Bolles 1981) over a seeded subsample, hypotheses from three points evaluated in batches,
then total least squares over all inliers. The road plane is nearly parallel to the optical axis, so the fit minimises
the distance to the plane, never an error along one axis.

A height field fits every road, but the errors of its coefficients grow with the scatter of the points. A plane has a
bias instead (Mallows 1973). A field is better if the road near the car leaves the plane by more than these errors, as
on roads that climb, or after noise has tilted the plane. The road is cut into patches. The median height of a patch's
cells above the plane is compared with its standard error and with the error of a field.
"""

import math
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.geometry.planes import Plane, PlaneSearch, distance_per_depth, facing, fit_plane
from roadperc_stream.model import Absent, Mask, Reason

_LOWER_IMAGE = 0.6
"""Share of the image below which rows count as road if there is no segmentation."""
_ONE_PLACE_M = 1e-6
"""Largest extent of points that count as one point, which fits no plane."""
_CAMERA_CENTRE = np.zeros(3)
_COLLINEAR = 1e-3
"""Sine of the angle between two sides of a triangle below which its points count as collinear."""
_BATCH: Final = 32
"""Planes evaluated in one matrix product; the search ends after a batch with a good plane."""
_SUBSAMPLE: Final = 2048
"""Points on which planes are evaluated: this gives the share of inliers to 1 %."""
_ENOUGH_POINTS: Final = 20_000
"""Points for the refit, at least; with more, the errors of single pixels average to far less than a millimetre."""
_KEPT: Final = 32
"""Hypotheses that a picture of the search can show."""
_ENOUGH_INLIERS: Final = 0.95
"""Share of inliers that ends the search."""
_MIN_INLIERS: Final = 0.2
"""Minimum share of inliers of a plane; noise and clutter reach less."""
_PATCH_M: Final = 5.0
"""Length of a patch; patches lie to the left and to the right of the ego x axis."""
_REACH_M: Final = 40.0
"""Distance up to which patches are compared; farther ones have few points, at a grazing angle."""
_HALF_WIDTH_M: Final = 4.0
_MIN_CELLS: Final = 5
_STDS: Final = 2.0
_MEDIAN_STD: Final = 1.25
"""Ratio of the standard errors of median and mean, for many normal errors."""
NORMAL_MAD: Final = 1.4826
"""Ratio of standard deviation and median absolute deviation of normal errors."""
_FIELD_STD: Final = 0.25
"""Ratio of a height field's error and the standard deviation of the cells' heights, measured on rendered roads."""
_FINEST_M: Final = 0.0005
"""Height up to which a patch never leaves the plane."""
_SHARE: Final = 0.2
"""Minimum share of patches that leave the plane."""
Indices = NDArray[np.intp]


def usable_pixels(cfg: SurfaceConfig, camera: Camera, depth_m: Float32, drivable: Mask | None) -> Mask:
    """(H, W) pixels that may belong to the road and have known depth (a comparison with NaN is False)."""
    top = int(camera.height * _LOWER_IMAGE) if drivable is None else first_row(drivable)
    usable = _unmarked_above(camera, top)
    with np.errstate(invalid="ignore"):
        np.less(depth_m[top:], np.float32(cfg.max_depth_m), out=usable[top:])
    if drivable is not None:
        usable[top:] &= drivable[top:]
    return usable


def _unmarked_above(camera: Camera, top: int) -> Mask:
    """A new (H, W) mask: False above row ``top``, not yet set from there on."""
    mask = np.empty(camera.size, bool)
    mask[:top] = False
    return mask


def points_of(camera: Camera, depth_m: Float32, rows: Indices, columns: Indices) -> Float:
    """(N, 3) points in the camera frame of the pixels at (N,) rows and columns, computed in float32."""
    x, y = ray_parts(camera)
    z = depth_m[rows, columns]
    return np.stack((x[columns] * z, y[rows] * z, z), axis=-1).astype(float)


def road_points(camera: Camera, depth_m: Float32, usable: Mask) -> Float:
    """(N, 3) points in the camera frame of an evenly spaced part of a mask's pixels; of few pixels, all."""
    count, top = number_of(usable), first_row(usable)
    step = max(math.isqrt(count // _ENOUGH_POINTS), 1)
    while number_of(usable[top::step, ::step]) * step**2 < count / 2:  # regular holes in the depth are in step
        step -= 1
    rows, columns = np.nonzero(usable[top::step, ::step])
    return points_of(camera, depth_m, top + rows * step, columns * step)


def pixels_near(camera: Camera, depth_m: Float32, plane: Plane, within_m: float, among: Mask) -> Mask:
    """(H, W) pixels of a mask within a distance of a plane in the camera's frame; False where the depth is unknown."""
    top = first_row(among)
    near = _unmarked_above(camera, top)
    column, row = distance_per_depth(camera, plane)
    distances_m = depth_m[top:] * (row[top:, None] + column)
    distances_m += np.float32(plane.offset_m)
    with np.errstate(invalid="ignore"):
        np.less_equal(np.abs(distances_m, out=distances_m), np.float32(within_m), out=near[top:])
    near[top:] &= among[top:]
    return near


@lru_cache(maxsize=4)
def ray_parts(camera: Camera) -> tuple[Float32, Float32]:
    """(W,) x of each column's rays with z = 1, and (H,) y of each row's rays."""
    x = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)
    return x, y


def first_row(mask: Mask) -> int:
    """The first row in which a mask is set; the last row if it is nowhere set."""
    first = int(mask.argmax())  # stops at the first True
    return first // mask.shape[1] if mask.flat[first] else len(mask) - 1


def number_of(mask: Mask) -> int:
    """Number of set pixels; NumPy takes three times as long."""
    return cv2.countNonZero(mask.view(np.uint8))


def road_plane(
    cfg: SurfaceConfig, camera: Camera, depth_m: Float32, usable: Mask, up: Float, rng: np.random.Generator
) -> tuple[Plane, float, PlaneSearch] | Absent:
    """The plane, facing the camera, with the most points of the road, the share of points on it, and its search.

    ``depth_m`` is (H, W) metres, ``usable`` (H, W) the pixels of the road with known depth. ``up`` is a (3,) unit
    vector roughly away from the road, in the camera's frame. ``rng`` draws the hypotheses. The search is in this frame.
    """
    points = road_points(camera, depth_m, usable)
    count = len(points)
    if count < 3:
        return Absent(Reason("surface", "too_few_road_points", (count,)))
    sample = points[rng.integers(0, count, min(_SUBSAMPLE, count))]
    found = _ransac(cfg, sample, up, rng) if np.ptp(sample.T.copy(), axis=1).max() > _ONE_PLACE_M else None
    if found is None:
        return Absent(Reason("surface", "no_plane", (count, _MIN_INLIERS)))
    refitted, search = found
    for fitted in (sample, points):  # after a refit to the sample, one to all points is enough
        close = np.abs(refitted.distance(fitted)) <= cfg.inlier_m
        if np.count_nonzero(close) < 3:
            return Absent(Reason("surface", "plane_without_points"))
        refitted = fit_plane(fitted, close)
    plane = facing(refitted, _CAMERA_CENTRE)
    # The refit may tilt a level hypothesis, for example if all points lie within ``inlier_m`` of each other.
    tilt_deg = float(np.degrees(np.arccos(min(abs(float(plane.n @ up)), 1.0))))
    if tilt_deg <= cfg.max_tilt_deg and plane.n @ up < 0:  # a level plane above the camera, because of wrong tags
        tilt_deg = 180.0 - tilt_deg
    if not tilt_deg <= cfg.max_tilt_deg:
        return Absent(Reason("surface", "plane_tilted", (tilt_deg, cfg.max_tilt_deg)))
    inliers = int(np.count_nonzero(np.abs(plane.distance(points)) <= cfg.inlier_m))
    return plane, inliers / count, search


def _ransac(cfg: SurfaceConfig, points: Float, up: Float, rng: np.random.Generator) -> tuple[Plane, PlaneSearch] | None:
    """The hypothesis with the most inliers, and the search; None if all have too few."""
    best, best_share, compared = None, _MIN_INLIERS, []
    for tried in range(0, cfg.hypotheses, _BATCH):
        if best_share >= _ENOUGH_INLIERS:
            break
        triples, normals, offsets = _hypotheses(points, up, cfg.max_tilt_deg, min(_BATCH, cfg.hypotheses - tried), rng)
        if not len(normals):
            continue
        shares = np.count_nonzero(np.abs(points @ normals.T + offsets) <= cfg.inlier_m, axis=0) / len(points)
        compared.append((shares, triples))
        top = int(np.argmax(shares))
        if shares[top] > best_share:
            best, best_share = Plane.of(normals[top], float(offsets[top])), float(shares[top])
    if best is None:
        return None
    shares, triples = (np.concatenate(parts) for parts in zip(*compared, strict=True))
    order = np.argsort(-shares, kind="stable")[:_KEPT]
    return best, PlaneSearch(points, triples[order], shares[order], len(shares), cfg.inlier_m)


def _hypotheses(
    points: Float, up: Float, max_tilt_deg: float, count: int, rng: np.random.Generator
) -> tuple[Float, Float, Float]:
    """(M, 3, 3) triples of points, not collinear or tilted, and (M, 3) normals, pointing up, and (M,) offsets."""
    triples = points[rng.integers(0, len(points), (count, 3))]
    a, b, c = np.moveaxis(triples, 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    sides = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    proper = lengths > _COLLINEAR * sides
    normals = normals[proper] / lengths[proper, None]
    cosines = normals @ up
    normals *= np.where(cosines < 0, -1.0, 1.0)[:, None]
    level = np.abs(cosines) >= np.cos(np.radians(max_tilt_deg))
    normals = normals[level]
    return triples[proper][level], normals, -np.sum(normals * a[proper][level], axis=1)


def leaves_plane(cells: Float) -> bool:
    """Whether a road leaves its plane by more than the error of a height field.

    ``cells`` are (N, 3) x ahead, y to the left and height above the plane, metres.
    """
    off = [_lies_off(heights) for heights in _patches(cells) if len(heights) >= _MIN_CELLS]
    return bool(off) and sum(off) >= _SHARE * len(off)


def median(values: Float) -> float:
    """Median of (N,) numbers, N > 0; np.median takes many times as long for a few hundred."""
    ordered, middle = np.sort(values), len(values) // 2
    return float(ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2)


def _lies_off(heights: Float) -> bool:
    """Whether the median of a patch's (N,) heights exceeds its standard error and a field's error."""
    middle = median(heights)
    std = NORMAL_MAD * median(np.abs(heights - middle))
    noise = _STDS * _MEDIAN_STD * std / math.sqrt(len(heights))
    return abs(middle) > max(noise, _FIELD_STD * std, _FINEST_M)


def _patches(cells: Float) -> list[Float]:
    """The heights of each patch's cells."""
    x, y, heights = cells[(cells[:, 0] < _REACH_M) & (np.abs(cells[:, 1]) < _HALF_WIDTH_M)].T
    patch = 2 * (x // _PATCH_M) + (y > 0)
    order = np.argsort(patch, kind="stable")
    _, first = np.unique(patch[order], return_index=True)
    return np.split(heights[order], first[1:])
