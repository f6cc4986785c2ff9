"""Detections filtered by the segmentation, each with the region that fits it best and its distance.

A detector with high recall reports false and hidden objects. The box of a hidden car lies on the car in front of it,
so each region belongs to the detection that it fits best. A detection is kept if a region of its class fits its box,
or (the lecture's filter) if enough of its box has tags of its class. Wrong tags cover an object or displace its border,
but not its depth: without such a region, one of any class above the ground may fit. The distance of a detection is a
low quantile of the region's distances.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import inf, log
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects import regions
from roadperc_stream.chain.stages.objects.mosaic import areas, corners, cut_out, kinds, shared_areas, with_classes
from roadperc_stream.chain.stages.objects.points import measured_by_points, measured_of_class, usual_heights
from roadperc_stream.chain.stages.objects.regions import UNKNOWN, Measured, Region, nearest, of_box
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Absent, Detection, Image, Object, Objects, Reason
from roadperc_stream.model.frame import Frame, mark
from roadperc_stream.model.tag_tables import label_lookup

SAME_DISTANCE = 0.03
"""Largest relative difference between the distances of two regions of one object, as they share a nearest point."""
SAME_PLACE = 0.5
"""Minimum overlap of two regions of one object, as a share of the smaller one's bounds."""
_ROWS = 64
"""Number of candidates compared with all others at once; a detector may report thousands."""
_NO_REGION: Final = (0.0, UNKNOWN)
FITS_ALIKE = 0.1
"""Difference below which fits count as equal."""
AS_EXPECTED = 0.1
"""Largest difference between the distance of a tracked object and the expected one, as a share."""
LEAST_RATIO = 0.03
"""Minimum share of its class in the box of a new object, even if its region fits well."""
_MIN_FIT = 0.7
"""Minimum fit of a region to its box for a detection to be kept."""
_BY_DEPTH = 0.95
"""Factor of the fit of a region of any class: regions of the class are chosen first."""
_GROUND: Final = ("road", "road_line", "ground", "sidewalk", "rail_track", "terrain")
_LEAST_USUAL = 0.1
"""Minimum weight of the height of a box at the distance of a region of any class."""
_MIN_FIT_SEEN = 0.2
"""Minimum fit for an object tracked for ``carry_after_s``; a share above ``min_class_ratio`` is also enough."""


def choose(
    labels: Sequence[str],
    candidates: Sequence[Sequence[Region]],
    measure: Callable[[Region], Measured],
    expected_m: Mapping[int, float | None],
) -> list[tuple[float, Measured]]:
    """Fit and distance of the region chosen for each detection; the best fits choose first.

    The fit is 0 and the distance unknown if other detections have all candidates.

    Args:
        labels: labels of the detections.
        candidates: candidate regions of each detection.
        measure: returns a region's distance; called only for regions that may be chosen.
        expected_m: expected distance of an object that is already tracked, by the position of its detection.
    """
    fits = _fits(candidates, measure := cache(measure), expected_m)
    unordered = [region for of_one in candidates for region in of_one]
    flat = [unordered[k] for k in sorted(range(len(fits)), key=lambda k: (-fits[k], k))]
    chosen: dict[int, tuple[float, Measured]] = {}
    claims: list[list[float | None]] = [[] for _ in flat]
    for row, (region, together) in enumerate(zip(flat, _same_places(labels, flat), strict=True)):
        if region.owner in chosen:
            continue
        measured = measure(region)
        if not any(_apart(measured.distance_m, claim) < SAME_DISTANCE for claim in claims[row]):
            chosen[region.owner] = region.fit, measured
            for other in np.flatnonzero(together).tolist():
                claims[other].append(measured.distance_m)
    return [chosen.get(owner, _NO_REGION) for owner in range(len(labels))]


def _fits(
    candidates: Sequence[Sequence[Region]],
    measure: Callable[[Region], Measured],
    expected_m: Mapping[int, float | None],
) -> list[float]:
    """The fit of each candidate; among equal fits, the one at a tracked object's expected distance wins.

    If none is at that distance, the nearest to it wins over an uncertain one, which may join two objects.
    """
    fits = [[region.fit for region in of_one] for of_one in candidates]
    for owner, distance_m in expected_m.items():
        best = max(fits[owner], default=0.0)
        alike = [k for k, fit in enumerate(fits[owner]) if fit > best - FITS_ALIKE]
        if distance_m is None or len(alike) < 2:
            continue
        found = [measure(candidates[owner][k]) for k in alike]
        off = [_apart(measured.distance_m, distance_m) for measured in found]
        if min(off) < AS_EXPECTED or _doubt(found[0]) > AS_EXPECTED:
            fits[owner][alike[off.index(min(off))]] = best + FITS_ALIKE
    return [fit for of_one in fits for fit in of_one]


def _same_places(labels: Sequence[str], flat: Sequence[Region]) -> Iterator[NDArray[np.bool_]]:
    """For each of M candidates, (M,) mask of those that may be the same object, by their place in the image."""
    kind = kinds(labels)[0][np.array([region.owner for region in flat], np.int64)]
    boxes = corners(region.box_px for region in flat)
    sizes = areas(boxes)
    for first in range(0, len(flat), _ROWS):
        rows = slice(first, first + _ROWS)
        smaller = np.minimum(sizes[rows, None], sizes)
        yield from (shared_areas(boxes[:, rows], boxes) > SAME_PLACE * smaller) & (kind[rows, None] == kind)


def _doubt(measured: Measured) -> float:
    """The standard deviation of a distance as a share of it; infinite if it is unknown."""
    return measured.std_m / measured.distance_m if measured.std_m and measured.distance_m else inf


def _apart(one_m: float | None, other_m: float | None) -> float:
    """Difference of two distances as a share; infinite if one is unknown or not positive."""
    if one_m is None or other_m is None or one_m <= 0 or other_m <= 0:
        return inf
    return abs(log(one_m / other_m))


def filter_detections(
    cfg: ObjectsConfig,
    frame: Frame,
    detections: tuple[Detection, ...] | None,
    expected_m: Mapping[int, float | None],
) -> Objects | Absent:
    """Every detection with its class ratio, whether it is kept, and its distance.

    Args:
        cfg: thresholds.
        frame: the frame; without tags every detection is kept.
        detections: in its image; None if the frame has no detections message.
        expected_m: expected distance of an object that is already tracked, None if unknown, by the detection's
            position. Such a detection needs a lower fit, and of equal fits the region at that distance wins.

    Returns:
        The objects in the detector's order. Detections with an unknown label are kept, without a ratio.
    """
    if detections is None:
        return Absent(Reason("objects", "no_detections"))
    lookups = [None if frame.table is None else label_lookup(frame.table, d.label) for d in detections]
    chosen = _candidates(cfg, frame, detections, lookups, expected_m)
    return Objects(
        tuple(
            _filtered(cfg, frame, detection, lookup, candidate, k in expected_m)
            for k, (detection, lookup, candidate) in enumerate(zip(detections, lookups, chosen, strict=True))
        )
    )


def divides(frame: Frame) -> bool:
    """Whether instance masks, or tags with dense depth, separate the objects of a class."""
    return frame.instances is not None or (frame.tags is not None and frame.dense_depth_m is not None)


def _candidates(
    cfg: ObjectsConfig,
    frame: Frame,
    detections: tuple[Detection, ...],
    lookups: list[Image | None],
    expected_m: Mapping[int, float | None],
) -> list[tuple[float, Measured]]:
    """Fit and distance of the region that is each detection's object."""
    if _has_points(frame) and cfg.distance_pixels == "region":
        return list(_by_points(cfg, frame, detections, lookups))
    if not divides(frame) or "region" not in (cfg.distance_pixels, cfg.filter):
        return [_NO_REGION] * len(detections)
    boxes = [detection.box_px for detection in detections]
    mosaic = cut_out(frame, lookups, boxes)
    found = regions.find_regions(frame.camera, mosaic, boxes)
    needed = [_MIN_FIT_SEEN if k in expected_m else _MIN_FIT for k in range(len(boxes))]
    poor = [max((r.fit for r in of_one), default=0.0) <= fit for of_one, fit in zip(found, needed, strict=True)]
    if frame.table is not None and frame.instances is None and any(poor):
        ground = frame.table.lookup(_GROUND)
        above = [
            1 - ground if is_poor and lookup is not None else None
            for is_poor, lookup in zip(poor, lookups, strict=True)
        ]
        others = regions.find_regions(frame.camera, with_classes(mosaic, frame, above, boxes), boxes)
        more = (_usual(cfg, frame, *of_one) for of_one in zip(detections, others, needed, strict=True))
        found = [(*of_class, *of_any) for of_class, of_any in zip(found, more, strict=True)]
    labels = [detection.label for detection in detections]
    return choose(labels, found, lambda region: regions.of_region(cfg, region, frame.inverse_depth_std), expected_m)


def _has_points(frame: Frame) -> bool:
    """Whether tags say which of a lidar's points are of a class."""
    return frame.tags is not None and frame.depth_m is not None and not divides(frame)


def _by_points(
    cfg: ObjectsConfig, frame: Frame, detections: tuple[Detection, ...], lookups: list[Image | None]
) -> Iterator[tuple[float, Measured]]:
    """The distance of each detection by a lidar's points of its class, without a region's fit."""
    kind, boxes = kinds([d.label for d in detections])[0], corners(d.box_px for d in detections)
    for k, (detection, lookup) in enumerate(zip(detections, lookups, strict=True)):
        if lookup is None:
            yield _NO_REGION
            continue
        others = boxes[:, (kind == kind[k]) & (np.arange(len(kind)) != k)]
        yield 0.0, measured_of_class(cfg, frame, detection, lookup, others)


def _usual(
    cfg: ObjectsConfig, frame: Frame, detection: Detection, found: Sequence[Region], least_fit: float
) -> Iterator[Region]:
    """Regions of any class that fit a detection's box, if it has a usual height at their distance."""
    height = (detection.box_px.y_max - detection.box_px.y_min) / frame.camera.fy
    for region in found:
        if _BY_DEPTH * region.fit > least_fit:
            heights_m = height * np.array(
                [regions.of_region(cfg, region, frame.inverse_depth_std).distance_m or np.nan]
            )
            if usual_heights(detection.label, heights_m)[0] > _LEAST_USUAL:
                yield replace(region, fit=_BY_DEPTH * region.fit)


def _filtered(
    cfg: ObjectsConfig,
    frame: Frame,
    detection: Detection,
    lookup: Image | None,
    candidate: tuple[float, Measured],
    expected: bool,
) -> Object:
    x0, y0, x1, y1 = box = detection.box_px.rounded(frame.camera.width, frame.camera.height)
    if x0 >= x1 or y0 >= y1:
        return Object(detection, kept=lookup is None)  # outside the image
    ratio = of_class = None
    fit, measured = candidate if cfg.distance_pixels == "region" else (candidate[0], UNKNOWN)
    if frame.tags is not None and lookup is not None:
        tags = frame.tags[y0:y1, x0:x1]
        marks = mark(tags, lookup)
        ratio = cv2.countNonZero(marks) / tags.size
        if fit <= _MIN_FIT or measured == UNKNOWN:
            of_class = marks
    beyond = fit <= _MIN_FIT and divides(frame) and _mostly_beyond(frame, box, of_class)
    kept = ratio is None or _is_kept(cfg, frame, ratio, fit, expected=expected, beyond=beyond)
    if beyond and cfg.distance_pixels == "region":
        measured = Measured(beyond_range=True)
    # Other detections have its pixels, or its points.
    claimed = fit == 0 and (divides(frame) or _has_points(frame)) and cfg.distance_pixels == "region"
    if frame.depth_m is not None and measured == UNKNOWN and of_class is None and cfg.distance_pixels == "region":
        measured = measured_by_points(cfg, frame.camera, frame.depth_m, frame.depth_limit_m, detection)
    elif frame.depth_m is not None and measured == UNKNOWN and not claimed:
        distances = of_box(frame.camera, frame.depth_m, box, frame.depth_limit_m)
        measured = nearest(cfg, _counted(cfg, distances, of_class), frame.inverse_depth_std)
    return Object(detection, kept, ratio, measured.distance_m, measured.std_m, beyond_range=measured.beyond_range)


def _counted(cfg: ObjectsConfig, distances_m: Float32, of_class: Image | None) -> Float32:
    """Distances of a box's pixels that count without a region: those of the class."""
    return distances_m.ravel() if of_class is None or cfg.distance_pixels == "box" else distances_m[of_class > 0]


def _mostly_beyond(frame: Frame, box: tuple[int, int, int, int], of_class: Image | None) -> bool:
    """Whether most pixels of the class in a box are beyond the depth's range, so that objects cannot be separated."""
    depth_m = frame.dense_depth_m
    if depth_m is None or of_class is None or frame.instances is not None:
        return False
    x0, y0, x1, y1 = box
    beyond = of_class[depth_m[y0:y1, x0:x1] >= np.float32(frame.depth_limit_m)]
    return 2 * cv2.countNonZero(beyond) > cv2.countNonZero(of_class)


def _is_kept(cfg: ObjectsConfig, frame: Frame, ratio: float, fit: float, *, expected: bool, beyond: bool) -> bool:
    """Whether a detection is kept, by its region's fit, or without regions by the share of its class in the box.

    There are no regions beyond the depth's range. For an expected object, either test is enough: its region may be
    wrong, or it may be partly hidden.
    """
    of_class = ratio > cfg.min_class_ratio
    if cfg.filter == "class_ratio" or not divides(frame):
        return of_class
    if expected:
        return fit > _MIN_FIT_SEEN or of_class
    return of_class if beyond else fit > _MIN_FIT and ratio > LEAST_RATIO
