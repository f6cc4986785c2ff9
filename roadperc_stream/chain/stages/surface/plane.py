"""A plane through the road's points.

Method: RANSAC (Fischler and Bolles 1981) over a seeded subsample, hypotheses from three points evaluated in batches,
then total least squares over all inliers. The road plane is nearly parallel to the optical axis, so the fit minimises
the distance to the plane, never an error along one axis.
"""

import numpy as np

from roadperc_stream.chain.stages.surface.points import count_of_pixels_near, plane_near, points_of
from roadperc_stream.core.config import SurfaceConfig
from roadperc_stream.core.datatypes import Absent, Mask, Reason
from roadperc_stream.core.geometry import Camera, Float, Float32, Plane, facing, fit_plane
from roadperc_stream.core.kernels.plane_pixels import marked

_CAMERA_CENTRE = np.zeros(3)
_COLLINEAR = 1e-3
"""Sine of the angle between two sides of a triangle below which its three points count as a line."""


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
    chosen = rng.integers(0, count, min(cfg.subsample, count))
    sample = points_of(camera, depth_m, marked(usable.view(np.uint8), chosen))
    plane = _ransac(cfg, sample, up, rng)
    if plane is None:
        return Absent(Reason("surface", "no_plane", (count, cfg.min_inliers)))
    refitted = _refitted(cfg, plane, sample)  # the sample's is cheap, and leaves one pass over all points to do
    if refitted is not None:
        refitted = plane_near(camera, depth_m, refitted, cfg.inlier_m, usable)
    if refitted is None:
        return Absent(Reason("surface", "plane_without_points"))
    plane = facing(refitted, _CAMERA_CENTRE)
    # The refit may turn a hypothesis that was level: of points that all lie within ``inlier_m`` it includes every one.
    tilt_deg = float(np.degrees(np.arccos(min(abs(float(plane.n @ up)), 1.0))))
    if tilt_deg <= cfg.max_tilt_deg and plane.n @ up < 0:  # level, but above the camera: what wrong tags take for road
        tilt_deg = 180.0 - tilt_deg
    if not tilt_deg <= cfg.max_tilt_deg:
        return Absent(Reason("surface", "plane_tilted", (tilt_deg, cfg.max_tilt_deg)))
    return plane, count_of_pixels_near(camera, depth_m, plane, cfg.inlier_m, usable) / count


def _refitted(cfg: SurfaceConfig, plane: Plane, points: Float) -> Plane | None:
    """The plane through those of (N, 3) points that lie within ``inlier_m`` of one; None where these are too few."""
    close = np.abs(plane.distance(points)) <= cfg.inlier_m
    return None if np.count_nonzero(close) < 3 else fit_plane(points, close)


def _ransac(cfg: SurfaceConfig, points: Float, up: Float, rng: np.random.Generator) -> Plane | None:
    """The hypothesis that most points support; None where none is supported enough."""
    best, best_share = None, cfg.min_inliers
    for tried in range(0, cfg.hypotheses, cfg.batch):
        if best_share >= cfg.enough_inliers:
            break
        normals, offsets = _hypotheses(points, up, cfg.max_tilt_deg, min(cfg.batch, cfg.hypotheses - tried), rng)
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
