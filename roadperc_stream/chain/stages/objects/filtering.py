"""Detections filtered by the segmentation, with their distance.

A detector of high recall finds much that is not there: a detection is kept when enough of its box carries its class's
tags. Its distance is a low quantile of the distances of the box's pixels, because the bare minimum jumps with every
stray pixel.
"""

import numpy as np

from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Absent, Detection, Object, Objects, Reason
from roadperc_stream.core.geometry import Camera, Float32
from roadperc_stream.core.scene import Scene
from roadperc_stream.core.semantics import label_lookup


def filter_detections(cfg: ObjectsConfig, scene: Scene, detections: tuple[Detection, ...] | None) -> Objects | Absent:
    """Every detection with its class ratio, whether it is kept, and its distance.

    Args:
        cfg: thresholds.
        scene: the frame; without tags every detection is kept.
        detections: in its image; None where the frame has no detections message.

    Returns:
        The objects in the detector's order. A label that no class belongs to is not filtered: kept, without a ratio.
    """
    if detections is None:
        return Absent(Reason("objects", "no_detections"))
    return Objects(tuple(_filtered(cfg, scene, detection) for detection in detections))


def _filtered(cfg: ObjectsConfig, scene: Scene, detection: Detection) -> Object:
    camera, tags, table, depth_m = scene.camera, scene.tags, scene.table, scene.depth_m
    x0, y0, x1, y1 = detection.box_px.rounded(camera.width, camera.height)
    lookup = label_lookup(table, detection.label) if table is not None else None
    if x0 >= x1 or y0 >= y1:
        return Object(detection, kept=lookup is None)  # nothing of it is in the image
    of_class = None
    ratio = None
    if tags is not None and lookup is not None:
        of_class = lookup[tags[y0:y1, x0:x1]].astype(bool)
        ratio = float(of_class.mean())
    kept = ratio is None or ratio > cfg.min_class_ratio
    if depth_m is None:
        return Object(detection, kept, ratio)
    distances = _distances(camera, depth_m, (x0, y0, x1, y1))
    depths = depth_m[y0:y1, x0:x1]
    if of_class is not None and cfg.distance_pixels == "class":
        distances, depths = distances[of_class], depths[of_class]
    distance, std, beyond = _nearest(cfg, distances.ravel(), depths.ravel(), scene.depth_limit_m)
    return Object(detection, kept, ratio, distance_m=distance, distance_std_m=std, beyond_range=beyond)


def _distances(camera: Camera, depth_m: Float32, box: tuple[int, int, int, int]) -> Float32:
    """(h, w) sqrt(x^2 + y^2 + z^2) in metres of the box's pixels."""
    x0, y0, x1, y1 = box
    x = (np.arange(x0, x1) - camera.cx) / camera.fx
    y = (np.arange(y0, y1) - camera.cy) / camera.fy
    lengths = np.sqrt((x**2 + 1.0).astype(np.float32) + (y**2).astype(np.float32)[:, None])
    distances: Float32 = depth_m[y0:y1, x0:x1] * lengths
    return distances


def _nearest(
    cfg: ObjectsConfig, distances_m: Float32, depths_m: Float32, limit_m: float
) -> tuple[float | None, float | None, bool]:
    """Distance, its standard deviation and whether the object lies beyond the depth's range.

    The deviation is that of the pixels around the quantile: what the choice of the quantile could have been; and no
    less than the quantile moves with the box.
    """
    known = np.isfinite(distances_m)
    if not known.any():
        return None, None, False
    saturated = depths_m[known] >= np.float32(limit_m)
    reachable = np.where(saturated, np.inf, distances_m[known])
    ranks = [_rank(share * cfg.distance_quantile, len(reachable)) for share in (0, 1, 2)]
    nearest, chosen, beside = np.partition(reachable, ranks)[ranks]
    distance = float(chosen)
    if not np.isfinite(distance):
        return None, None, True
    spread = beside - nearest
    std = max(float(spread) / 2, cfg.min_distance_std_m) if np.isfinite(spread) else None
    return distance, std, False


def _rank(quantile: float, count: int) -> int:
    """Position of a quantile among sorted values, the nearest one below."""
    return min(int(quantile * (count - 1)), count - 1)
