"""Detections filtered by the segmentation, each with the region that fits it best and its distance.

A detector with high recall reports false and hidden objects. The box of a hidden car lies on the car in front of it,
so each region belongs to the detection that it fits best. A detection is kept if a region of its class fits its box,
or (the lecture's filter) if enough of its box has tags of its class. Wrong tags cover an object or displace its border,
but not its depth: without such a region, one of any class above the ground may fit. The distance of a detection is a
low quantile of the region's distances.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from math import exp, hypot, inf, log
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects import regions
from roadperc_stream.chain.stages.objects.mosaic import (
    areas,
    corners,
    cut_out,
    kinds,
    part_of,
    shared_areas,
    with_classes,
)
from roadperc_stream.chain.stages.objects.points import (
    RARE,
    measured_by_points,
    measured_of_class,
    std_by_others_m,
    usual_heights,
)
from roadperc_stream.chain.stages.objects.regions import MOST_STD_SHARE, UNKNOWN, Measured, Region, nearest, of_box
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Absent, Detection, Image, Object, Objects, Reason
from roadperc_stream.model.changed import changed
from roadperc_stream.model.frame import Frame, mark
from roadperc_stream.model.tag_tables import label_lookup

SAME_DISTANCE = 0.03
"""Largest relative difference between the distances of two regions of one object, as they share a nearest point."""
SAME_PLACE = 0.5
"""Minimum overlap of two regions of one object, as a share of the smaller one's bounds."""
_ROWS = 64
"""Number of candidates compared with all others at once; a detector may report thousands."""
_NO_REGION: Final = (0.0, UNKNOWN)
_DOUBTFUL: Final = Measured(std_m=inf)
"""The result if the deviation due to other regions, or to the expected distance, exceeds ``MOST_STD_SHARE``. Unlike
``UNKNOWN``, it does not fall back to the pixels of the box."""
# The next five values were fitted on rendered scenes, seeds from 560 on.
_LEAST_STD_SHARE: Final = 0.025
"""Least standard deviation of a tracked object's measured or expected distance, as a share."""
_AGREES: Final = 0.5
"""Agreement from which regions that are much less likely are not measured."""
_STEEPNESS: Final = 12
"""Power of the fit that is the weight of a region."""
_EXPECTED_WEIGHT: Final = 0.75**_STEEPNESS
"""Weight of the case that a tracked object is at its expected distance and none of the regions is the object."""
_EXPECTED_FACTOR: Final = 3.0
"""Factor of the sum of this weight and a region's own, for a region at the expected distance."""
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
    expected: Mapping[int, Measured],
) -> list[tuple[float, Measured]]:
    """Fit and distance of the region chosen for each detection; the largest weights choose first.

    The fit is 0 and the distance unknown if other detections have all candidates.

    Args:
        labels: labels of the detections.
        candidates: candidate regions of each detection.
        measure: returns a region's distance; called only for regions that may be chosen or are likely.
        expected: predicted distance of an object that is already tracked, by the position of its detection.
    """
    measure = cache(measure)
    unordered = [
        (weight, region)
        for owner, of_one in enumerate(candidates)
        for weight, region in zip(_weights(of_one, measure, expected.get(owner, UNKNOWN)), of_one, strict=True)
    ]
    weighted = sorted(unordered, key=lambda candidate: -candidate[0])
    chosen: dict[int, int] = {}
    claims: list[list[float | None]] = [[] for _ in weighted]

    def claimed(row: int) -> bool:
        distance_m = measure(weighted[row][1]).distance_m
        return any(_apart(distance_m, claim) < SAME_DISTANCE for claim in claims[row])

    for row, together in enumerate(_same_places(labels, [region for _, region in weighted])):
        region = weighted[row][1]
        if region.owner not in chosen and not claimed(row):
            chosen[region.owner] = row
            for other in np.flatnonzero(together).tolist():
                claims[other].append(measure(region).distance_m)
    others = {owner: [(_sharpness(one) * _EXPECTED_WEIGHT, one)] for owner, one in expected.items()}
    for row, (weight, region) in enumerate(weighted):
        best = chosen.get(region.owner, row)
        if row != best and weight > RARE * weighted[best][0] and not claimed(row):
            others.setdefault(region.owner, []).append((weight, measure(region)))
    found = [_NO_REGION] * len(labels)
    for owner, row in chosen.items():
        weight, region = weighted[row]
        found[owner] = region.fit, _with_other_regions(measure(region), weight, others.get(owner, ()))
    return found


def _weights(candidates: Sequence[Region], measure: Callable[[Region], Measured], expected: Measured) -> list[float]:
    """The weight of each candidate of a detection.

    For a tracked object, it is larger near the expected distance, and lower for uncertain distances, which may be of
    two objects.
    """
    weights = [region.fit**_STEEPNESS for region in candidates]
    if expected.distance_m is None:
        return weights
    least = 0.0
    for k in sorted(range(len(weights)), key=lambda k: -weights[k]):
        if weights[k] < least:
            break  # the others are much less likely than a region at the expected distance: do not measure them
        measured = measure(candidates[k])
        agreement = _agreement(measured, expected)
        weights[k] += agreement * (_EXPECTED_FACTOR * (weights[k] + _EXPECTED_WEIGHT) - weights[k])
        weights[k] *= _sharpness(measured)
        if agreement > _AGREES:
            least = RARE * weights[k]
    return weights


def _agreement(measured: Measured, expected: Measured) -> float:
    """Likelihood of a distance, 0 to 1, for a tracked object; both may have a standard deviation."""
    if measured.distance_m is None or expected.distance_m is None:
        return 0.0
    both = Measured(expected.distance_m, hypot(measured.std_m or 0.0, expected.std_m or 0.0))
    sigmas = (measured.distance_m - expected.distance_m) / _std_m(both)
    return _sharpness(both) * exp(-0.5 * sigmas**2)


def _sharpness(measured: Measured) -> float:
    """Relative probability density, 0 to 1, of a distance with a standard deviation; 0 if it is unknown."""
    return _LEAST_STD_SHARE * measured.distance_m / _std_m(measured) if measured.distance_m else 0.0


def _std_m(measured: Measured) -> float:
    return hypot(_LEAST_STD_SHARE * (measured.distance_m or 0.0), measured.std_m or 0.0)


def _with_other_regions(measured: Measured, weight: float, others: Sequence[tuple[float, Measured]]) -> Measured:
    """The distance with a deviation for the likely ones of the other distances; doubtful if that is too large.

    ``others`` are weights and distances of other regions, and of the expected distance. A distance within the
    deviation of another one does not contradict it.
    """
    distance_m, std_m = measured.distance_m, measured.std_m
    if distance_m is None or std_m is None:
        return measured
    known = [(w, m.distance_m, m.std_m or 0.0) for w, m in others if m.distance_m is not None]
    off_m = [max(abs(other_m - distance_m) - other_std_m, 0.0) for _, other_m, other_std_m in known]
    if not any(off_m):
        return measured
    others_m = std_by_others_m(np.array([weight, *(w for w, _, _ in known)]), np.array([0.0, *off_m]))
    return changed(measured, std_m=hypot(std_m, others_m)) if others_m < MOST_STD_SHARE * distance_m else _DOUBTFUL


def _same_places(labels: Sequence[str], flat: Sequence[Region]) -> Iterator[NDArray[np.bool_]]:
    """For each of M candidates, (M,) mask of those that may be the same object, by their place in the image."""
    kind = kinds(labels)[0][np.array([region.owner for region in flat], np.int64)]
    boxes = corners(region.box_px for region in flat)
    sizes = areas(boxes)
    for first in range(0, len(flat), _ROWS):
        rows = slice(first, first + _ROWS)
        smaller = np.minimum(sizes[rows, None], sizes)
        yield from (shared_areas(boxes[:, rows], boxes) > SAME_PLACE * smaller) & (kind[rows, None] == kind)


def _apart(one_m: float | None, other_m: float | None) -> float:
    """Difference of two distances as a share; infinite if one is unknown or not positive."""
    if one_m is None or other_m is None or one_m <= 0 or other_m <= 0:
        return inf
    return abs(log(one_m / other_m))


def filter_detections(
    cfg: ObjectsConfig,
    frame: Frame,
    detections: tuple[Detection, ...] | None,
    expected: Mapping[int, Measured],
) -> Objects | Absent:
    """Every detection with its class ratio, whether it is kept, and its distance.

    Args:
        cfg: thresholds.
        frame: the frame; without tags every detection is kept.
        detections: in its image; None if the frame has no detections message.
        expected: predicted distance of an object that is already tracked, or ``UNKNOWN``, by the position of its
            detection. Such a detection needs a lower fit, and regions near that distance have a larger weight.

    Returns:
        The objects in the detector's order. Detections with an unknown label are kept, without a ratio.
    """
    if detections is None:
        return Absent(Reason("objects", "no_detections"))
    lookups = [None if frame.table is None else label_lookup(frame.table, d.label) for d in detections]
    chosen = _candidates(cfg, frame, detections, lookups, expected)
    return Objects(
        tuple(
            _filtered(cfg, frame, detection, lookup, candidate, k in expected)
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
    expected: Mapping[int, Measured],
) -> list[tuple[float, Measured]]:
    """Fit and distance of the region that is each detection's object."""
    if _has_points(frame) and cfg.distance_pixels == "region":
        return list(_by_points(cfg, frame, detections, lookups))
    if not divides(frame) or "region" not in (cfg.distance_pixels, cfg.filter):
        return [_NO_REGION] * len(detections)
    boxes = [detection.box_px for detection in detections]
    mosaic = cut_out(frame, lookups, boxes)
    found = regions.find_regions(frame.camera, mosaic, boxes)
    needed = [_MIN_FIT_SEEN if k in expected else _MIN_FIT for k in range(len(boxes))]
    poor = [max((r.fit for r in of_one), default=0.0) <= fit for of_one, fit in zip(found, needed, strict=True)]
    few = [k for k, is_poor in enumerate(poor) if is_poor and lookups[k] is not None]
    if frame.table is not None and frame.instances is None and few:
        above = with_classes(part_of(mosaic, few), [1 - frame.table.lookup(_GROUND)] * len(few))
        others = regions.find_regions(frame.camera, above, [boxes[k] for k in few])
        for k, of_any in zip(few, others, strict=True):
            found[k] += tuple(_usual(cfg, frame, detections[k], k, of_any, needed[k]))
    labels = [detection.label for detection in detections]
    return choose(labels, found, lambda region: regions.of_region(cfg, region, frame.inverse_depth_std), expected)


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
    cfg: ObjectsConfig, frame: Frame, detection: Detection, owner: int, found: Sequence[Region], least_fit: float
) -> Iterator[Region]:
    """Regions of any class that fit a detection's box, if it has a usual height at their distance."""
    height = (detection.box_px.y_max - detection.box_px.y_min) / frame.camera.fy
    for region in found:
        if _BY_DEPTH * region.fit > least_fit:
            at = regions.of_region(cfg, region, frame.inverse_depth_std)
            if usual_heights(detection.label, height * np.array([at.distance_m or np.nan]))[0] > _LEAST_USUAL:
                yield changed(region, owner=owner, fit=_BY_DEPTH * region.fit)


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
    measured = UNKNOWN if measured == _DOUBTFUL else measured
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
