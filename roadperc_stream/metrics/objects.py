"""Metrics of detections against the true objects: one row per detection, and the sums of a frame."""

from collections.abc import Container, Mapping, Sequence
from functools import lru_cache
from math import hypot
from typing import Any, Final

import numpy as np

from roadperc_stream.model import Absent, Frame, FrameResult, Object, Objects, Sample
from roadperc_stream.model.tag_tables import classes_of_label
from roadperc_stream.schemas.columns import FrameKey, ObjectMetrics
from roadperc_stream.schemas.columns.errors import ObjectErrorColumns, TrueImpactColumns, TrueObjectColumns
from roadperc_stream.schemas.columns.estimates import ObjectColumns
from roadperc_stream.schemas.columns.places import FramePlaces, ObjectPlaceColumns, TrueObject

_COLUMNS: Final = frozenset(ObjectMetrics.__dataclass_fields__)
_TRUE: Final = ("distance_m", "closing_speed_mps", "lateral_m", "in_path")
"""Fields of the matching true object, whose columns begin with ``true_``."""
MATCH_OVERLAP = 0.5
"""Intersection over union from which a detection matches a true object of its kind."""


def object_metrics(log_id: str, sample: Sample, result: FrameResult) -> tuple[tuple[ObjectMetrics, ...], FramePlaces]:
    """The rows of all detections of a frame, and the places of the detections and of the true objects."""
    objects = () if isinstance(result.objects, Absent) else result.objects.objects
    truth = sample.truth.objects
    partners = true_partners(objects, truth)
    pairs = list(zip(objects, partners, strict=True))
    key = vars(FrameKey(log_id, sample.index, sample.frame.stamp_ns))
    rows = tuple(_object_row(key, *pair, None if truth is None else pair[1] is not None) for pair in pairs)
    detected = {id(partner) for item, partner in pairs if item.kept and item.status == "measured"}
    true = None if truth is None else _true_objects(sample.frame, truth.objects, detected)
    return rows, FramePlaces(_places(sample.frame, objects), true)


def _object_row(key: Mapping[str, Any], item: Object, partner: Object | None, is_true: bool | None) -> ObjectMetrics:
    """The row of a detection; fields of the same name are copied."""
    found = item.detection
    same = {name: value for name, value in vars(item).items() if name in _COLUMNS}
    box = {f"{side}_px": value for side, value in vars(found.box_px).items()}
    known = {
        "track_id": item.track_id or None,
        "distance_source": None if item.distance_m is None else item.distance_source,
        "is_true": is_true,
        "true_time_to_impact_s": None if partner is None else true_time_to_impact_s(partner),
        **{f"true_{name}": getattr(partner, name, None) for name in _TRUE},
    }
    return ObjectMetrics(**key, label=found.label, score=found.score, **same | box | known)


def true_time_to_impact_s(true: Object) -> float | None:
    """The true time to impact; else its distance over its closing speed.

    None if the object does not come nearer. If the truth has ``in_path``, its own time counts, even if it is None.
    """
    if true.in_path is not None:
        return true.time_to_impact_s
    if true.time_to_impact_s is not None or true.distance_m is None or true.closing_speed_mps is None:
        return true.time_to_impact_s
    return true.distance_m / true.closing_speed_mps if true.closing_speed_mps > 0 else None


def object_columns(objects: Objects | Absent) -> ObjectColumns:
    """The counts of detections, and the nearest and most urgent kept object."""
    if isinstance(objects, Absent):
        return ObjectColumns()
    kept = [item for item in objects.objects if item.kept]
    in_path = [item.in_path for item in kept if item.in_path is not None]
    nearest, urgent = objects.nearest, objects.most_urgent
    return ObjectColumns(
        detections=sum(item.status == "measured" for item in objects.objects),
        detections_kept=sum(item.status == "measured" for item in kept),
        detections_unjudged=sum(item.kept and item.class_ratio is None for item in objects.objects),
        objects_carried=sum(item.status == "tracked" for item in kept),
        nearest_object_m=None if nearest is None else nearest.distance_m,
        nearest_object_class=None if nearest is None else nearest.detection.label,
        time_to_impact_s=None if urgent is None else urgent.time_to_impact_s,
        time_to_impact_std_s=None if urgent is None else urgent.time_to_impact_std_s,
        path_source=objects.path_source,
        objects_in_path=sum(in_path) if in_path or not kept else None,
        cut_ins=sum(bool(item.cut_in) for item in kept) if objects.path_source == "lane" else None,
    )


def object_errors(objects: Objects | Absent, truth: Objects | None) -> ObjectErrorColumns:
    """Mean distance error of kept objects, and the scores of the filter; empty columns without true objects."""
    if isinstance(objects, Absent) or truth is None:
        return ObjectErrorColumns()
    pairs = list(zip(objects.objects, true_partners(objects.objects, truth), strict=True))
    errors = [
        abs(item.distance_m - true.distance_m)
        for item, true in pairs
        if true is not None and item.kept and item.distance_m is not None and true.distance_m is not None
    ]
    # Only detections of this frame score the filter; a kept detection that matches a true object is a true positive.
    judged = [(item.kept, true is not None) for item, true in pairs if item.status == "measured"]
    tp, fp = judged.count((True, True)), judged.count((True, False))
    fn, tn = judged.count((False, True)), judged.count((False, False))
    return ObjectErrorColumns(
        object_distance_error_m=float(np.mean(errors)) if errors else None,
        filter_tp=tp,
        filter_fp=fp,
        filter_fn=fn,
        filter_tn=tn,
        filter_precision=tp / (tp + fp) if tp + fp else None,
        filter_recall=tp / (tp + fn) if tp + fn else None,
    )


def true_impact(objects: Objects | Absent, truth: Objects | None) -> TrueImpactColumns:
    """The smallest true time to impact of the objects in the path, and the estimate's error.

    None if the truth lacks ``in_path``.
    """
    ahead = () if truth is None else (item for item in truth.objects if item.in_path)
    true_s = min((impact for item in ahead if (impact := true_time_to_impact_s(item)) is not None), default=None)
    urgent = None if isinstance(objects, Absent) else objects.most_urgent
    impact_s = None if urgent is None else urgent.time_to_impact_s
    return TrueImpactColumns(true_s, None if impact_s is None or true_s is None else impact_s - true_s)


def true_objects(truth: Objects | None) -> TrueObjectColumns:
    """The classes and places of the true objects with a distance."""
    placed = [item for item in truth.objects if item.distance_m is not None] if truth else []
    laterals = [item.lateral_m for item in placed if item.lateral_m is not None]
    return TrueObjectColumns(
        tuple(item.detection.label for item in placed),
        tuple(item.distance_m for item in placed if item.distance_m is not None),
        tuple(laterals) if len(laterals) == len(placed) else (),
    )


def _places(frame: Frame, objects: Sequence[Object]) -> tuple[ObjectPlaceColumns, ...]:
    """The place on the ground of each object with a distance, in the direction of its box's middle."""
    camera = frame.camera
    (xx, xy, xz, x), (yx, yy, yz, y) = frame.ego_T_camera[:2].tolist()
    places = []
    for item in objects:
        if item.distance_m is None:
            places.append(ObjectPlaceColumns())
            continue
        box_px = item.detection.box_px
        right = ((box_px.x_min + box_px.x_max - 1) / 2 - camera.cx) / camera.fx
        down = ((box_px.y_min + box_px.y_max - 1) / 2 - camera.cy) / camera.fy
        ahead_m = item.distance_m / hypot(right, down, 1.0)
        x_m = (xx * right + xy * down + xz) * ahead_m + x
        places.append(ObjectPlaceColumns(x_m, (yx * right + yy * down + yz) * ahead_m + y))
    return tuple(places)


def _true_objects(frame: Frame, objects: Sequence[Object], detected: Container[int]) -> tuple[TrueObject, ...]:
    """All true objects of a frame with their places; ``detected`` are the ``id`` of those with a detection."""
    return tuple(
        TrueObject(
            item.track_id or item.detection.id,
            item.detection.label,
            place.x_m,
            place.y_m,
            item.closing_speed_mps,
            true_time_to_impact_s(item),
            item.in_path,
            id(item) in detected,
        )
        for item, place in zip(objects, _places(frame, objects), strict=True)
    )


def true_partners(objects: Sequence[Object], truth: Objects | None) -> list[Object | None]:
    """The true object that each detection matches: pairs of one kind, largest overlap first, each object used once."""
    partners: list[Object | None] = [None] * len(objects)
    used: set[int] = set()
    true = () if truth is None else truth.objects
    for _, i, k in sorted(_candidates(objects, true)):
        if partners[i] is None and k not in used:
            partners[i] = true[k]
            used.add(k)
    return partners


def _candidates(objects: Sequence[Object], true: Sequence[Object]) -> list[tuple[float, int, int]]:
    """Negative overlap and both indices of each candidate pair."""
    pairs = ((i, k, a.detection, b.detection) for i, a in enumerate(objects) for k, b in enumerate(true))
    overlaps = ((a.box_px.overlap(b.box_px), i, k) for i, k, a, b in pairs if same_kind(a.label, b.label))
    return [(-overlap, i, k) for overlap, i, k in overlaps if overlap >= MATCH_OVERLAP]


@lru_cache(maxsize=1024)
def same_kind(label: str, other: str) -> bool:
    """Whether both labels share a class; labels without classes must be equal."""
    classes, others = classes_of_label(label), classes_of_label(other)
    if classes is None or others is None:
        return label.strip().lower() == other.strip().lower()
    return not set(classes).isdisjoint(others)
