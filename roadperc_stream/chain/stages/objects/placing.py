"""Where an object is beside the path: how far its pixels reach to the left and to the right of the path's middle."""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.chain.stages.objects.path import EgoPath
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Box, Object
from roadperc_stream.core.geometry import Float, Float32, rays, transform
from roadperc_stream.core.scene import Scene
from roadperc_stream.core.semantics import label_lookup

_MOST_PIXELS = 2000
"""A place needs no more."""
_FEWEST_PIXELS = 5
_NEARER_SHARE = 0.05
"""Pixels nearer than the object by more than this share of its distance are of something before it."""
_NEARER_M = 0.3
_OUTERMOST = 0.02
"""Share of the pixels beyond either edge: strays at the border of the class."""
_NEAREST = 0.05
"""Share of the pixels that are the nearest ones."""
_STD_SHARE = 0.005
"""Of the distance, beside the least standard deviation of an edge: what a wobbling border and the path are off."""


@dataclass(frozen=True)
class Extent:
    """The edges of an object, metres to the left of the path's middle, and their standard deviation.

    ``nearest_ray`` is the direction of its nearest pixels, z = 1 in the camera's frame.
    """

    right_m: float
    left_m: float
    std_m: float
    nearest_ray: tuple[float, float, float]


def extent(cfg: ObjectsConfig, scene: Scene, path: EgoPath, item: Object) -> Extent | None:
    """Where the object's nearest pixels lie, to ``object_length_m`` behind its nearest point.

    Args:
        cfg: lengths and deviations.
        scene: the frame.
        path: the car's, in the ego frame.
        item: with its distance, this frame's own.

    Returns:
        None where too few pixels have a depth.
    """
    if item.distance_m is None or scene.depth_m is None:
        return None
    points = _points(cfg, scene, scene.depth_m, item, item.distance_m)
    if len(points) < _FEWEST_PIXELS:
        return None
    lateral = path.lateral(transform(scene.ego_T_camera, points)[:, :2])
    right, left = np.quantile(lateral, (_OUTERMOST, 1.0 - _OUTERMOST))
    return Extent(float(right), float(left), cfg.lateral_std_m + _STD_SHARE * item.distance_m, _nearest_ray(points))


def _nearest_ray(points: Float) -> tuple[float, float, float]:
    """The mean direction of the nearest of (N, 3) points."""
    ranges = np.linalg.norm(points, axis=1)
    nearest = points[ranges <= np.quantile(ranges, _NEAREST)]
    x, y = (nearest[:, :2] / nearest[:, 2:]).mean(axis=0).tolist()
    return x, y, 1.0


def _points(cfg: ObjectsConfig, scene: Scene, depth_m: Float32, item: Object, distance_m: float) -> Float:
    """(N, 3) points of the object in the camera's frame."""
    camera, box = scene.camera, item.detection.box_px
    rows, columns = _grid(box, camera.width, camera.height)
    depths = depth_m[rows, columns]
    points = rays(camera, np.stack((columns, rows), axis=-1).reshape(-1, 2).astype(np.float64)) * depths.reshape(-1, 1)
    with np.errstate(invalid="ignore"):
        behind_m = np.linalg.norm(points, axis=1) - distance_m
    chosen = (behind_m > -_NEARER_M - _NEARER_SHARE * distance_m) & (behind_m < cfg.object_length_m)
    if scene.tags is not None and scene.table is not None:
        lookup = label_lookup(scene.table, item.detection.label)
        if lookup is not None:
            chosen &= lookup[scene.tags[rows, columns]].astype(bool).ravel()
    return np.asarray(points[chosen], np.float64)


def _grid(box: Box, width: int, height: int) -> tuple[Float, Float]:
    """(h, w) rows and (h, w) columns of pixels spread over a box, every one of a small box."""
    x0, y0, x1, y1 = box.rounded(width, height)
    step = max(int(np.ceil(np.sqrt(max(x1 - x0, 0) * max(y1 - y0, 0) / _MOST_PIXELS))), 1)
    rows, columns = np.mgrid[y0:y1:step, x0:x1:step]
    return rows, columns
