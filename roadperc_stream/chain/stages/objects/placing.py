"""Where an object is beside the path: how far its pixels reach to the left and to the right of the path's middle."""

from dataclasses import dataclass
from math import ceil, sqrt

from roadperc_stream.chain.stages.objects.distance import ranked
from roadperc_stream.chain.stages.objects.path import EgoPath
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Detection, Object
from roadperc_stream.core.geometry import Float, Float32
from roadperc_stream.core.kernels.object_points import mean_direction, object_points
from roadperc_stream.core.scene import Scene
from roadperc_stream.core.semantics import label_lookup

_MOST_PIXELS = 1000
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
    points, ranges_m, lateral_m = _points(cfg, scene, scene.depth_m, path, item.detection, item.distance_m)
    if len(points) < _FEWEST_PIXELS:
        return None
    right, left = ranked(lateral_m, _OUTERMOST, 1.0 - _OUTERMOST)
    nearest_ray = *mean_direction(points, ranges_m, ranked(ranges_m, _NEAREST)[0]), 1.0
    return Extent(right, left, cfg.lateral_std_m + _STD_SHARE * item.distance_m, nearest_ray)


def _points(
    cfg: ObjectsConfig, scene: Scene, depth_m: Float32, path: EgoPath, detection: Detection, distance_m: float
) -> tuple[Float, Float, Float]:
    """(N, 3) points of the object in the camera's frame, their distances, and how far they are left of the path.

    They are of pixels spread over its box: of every one of a small box.
    """
    camera = scene.camera
    x0, y0, x1, y1 = detection.box_px.rounded(camera.width, camera.height)
    step = max(ceil(sqrt(max(x1 - x0, 0) * max(y1 - y0, 0) / _MOST_PIXELS)), 1)
    lookup = None if scene.table is None else label_lookup(scene.table, detection.label)
    of_class = None if scene.tags is None or lookup is None else (scene.tags, lookup)
    behind_m = -_NEARER_M - _NEARER_SHARE * distance_m, cfg.object_length_m
    pinhole = camera.fx, camera.fy, camera.cx, camera.cy
    return object_points(
        depth_m, pinhole, (x0, y0, x1, y1, step), of_class, distance_m, behind_m, scene.ego_T_camera, path.circle
    )
