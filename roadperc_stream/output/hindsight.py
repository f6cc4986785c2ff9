"""Fills the columns by hindsight at the end of a replay, from the rows of its tables and what frames claim beyond."""

from array import array
from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.metrics.hindsight import (
    CLAIMS,
    FRAME_COLUMNS,
    OBJECT_COLUMNS,
    REACH_S,
    frame_hindsight,
    object_hindsight,
    objects_in_frames,
)
from roadperc_stream.metrics.smoothing import JITTER_NS
from roadperc_stream.output.tables import TableWriter
from roadperc_stream.schemas.columns import FrameMetrics, ObjectMetrics
from roadperc_stream.system.time import NS_PER_S

Recent = tuple[FrameMetrics, tuple[ObjectMetrics, ...]]
"""The rows of one frame."""
RECENT_NS: Final = round(REACH_S * NS_PER_S) + JITTER_NS
"""How long a continued replay needs the rows before it."""


class Hindsight:
    """What the frames of a replay claim; ``earlier`` are the last rows of the replay that it continues."""

    def __init__(self, earlier: Iterable[Recent]) -> None:
        self._earlier = tuple(earlier)
        self._claims = array("d")

    def add(self, claims: Iterable[float]) -> None:
        """Add the claims of one frame."""
        self._claims.extend(claims)

    def fill(self, frames: TableWriter, objects: TableWriter) -> None:
        """Fill the columns of both tables.

        Raises:
            TargetError: a table cannot be written.
        """
        rows_before = [row for row, _ in self._earlier]
        tracks_before = [item for _, items in self._earlier for item in items]
        rows, tracks = frames.columns([*FRAME_COLUMNS], rows_before), objects.columns([*OBJECT_COLUMNS], tracks_before)
        claims = np.full((len(rows["frame"]), CLAIMS), np.nan)
        claims[len(rows_before) :] = np.reshape(self._claims, (-1, CLAIMS))
        of_tracks = object_hindsight(tracks)
        found = frame_hindsight(rows, claims) | objects_in_frames(rows, tracks, of_tracks)
        objects.fill(_without(of_tracks, len(tracks_before)))
        frames.fill(_without(found, len(rows_before)))


def _without(columns: Mapping[str, Float], first: int) -> dict[str, Float]:
    return {name: values[first:] for name, values in columns.items()}
