"""Columns of places on the ground, which are only in the Parquet tables."""

from dataclasses import dataclass
from typing import Annotated, Final

from roadperc_stream.schemas.columns.column import Column, columns_of

_PLACE = "on the ground in the ego frame: at `distance_m` in the direction of the box's middle"


@dataclass(frozen=True)
class TrueObject:
    """A true object of a frame.

    ``x_m`` (forward) and ``y_m`` (left) are its place, computed as that of a detection. ``id`` is empty if the truth
    has none. ``detected``: a kept detection of the frame, not only a tracked object, matches it.
    """

    id: str
    label: str
    x_m: float | None
    y_m: float | None
    closing_speed_mps: float | None
    time_to_impact_s: float | None
    in_path: bool | None
    detected: bool


@dataclass(frozen=True)
class TrueObjectListColumns:
    """The true objects of the frame, one by one."""

    true_objects: Annotated[
        tuple[TrueObject, ...] | None,
        Column(
            "all true objects: `id`, `label`, `x_m`, `y_m`, `closing_speed_mps`, `time_to_impact_s`, `in_path`, and "
            "`detected`: whether a kept detection with status `measured` matches it",
            null="the log has no true objects",
        ),
    ] = None


@dataclass(frozen=True)
class ObjectPlaceColumns:
    """The place of a detection."""

    x_m: Annotated[float | None, Column(f"forward, {_PLACE}", "m", "no distance")] = None
    y_m: Annotated[float | None, Column(f"left, {_PLACE}", "m", "no distance")] = None


@dataclass(frozen=True)
class FramePlaces:
    """The places of a frame's detections, in the order of their rows, and its true objects."""

    objects: tuple[ObjectPlaceColumns, ...] = ()
    true_objects: tuple[TrueObject, ...] | None = None


(TRUE_OBJECTS,) = columns_of(TrueObjectListColumns)
OBJECT_PLACE: Final = tuple(columns_of(ObjectPlaceColumns))
"""Names of the columns, which follow the row in the tables and are not in its message."""
