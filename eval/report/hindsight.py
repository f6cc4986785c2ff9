"""How far hindsight can be believed: its errors beside those against truth, of the same frames and detections."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
import polars as pl

from roadperc_stream.geometry import Float
from roadperc_stream.output.text_table import Row, Table

from ..report_columns import percent
from .consistency import kept_objects
from .sources import Frames

_FEWEST: Final = 10
_OF_FRAMES: Final = {
    "lane_left_hindsight_m": ("lane_left_error_m", None),
    "lane_right_hindsight_m": ("lane_right_error_m", None),
    "step_hindsight_m": ("step_m", "true_step_m"),
}
_OF_OBJECTS: Final = {
    "object_distance_hindsight_m": ("distance_m", "true_distance_m"),
    "closing_speed_hindsight_mps": ("closing_speed_mps", "true_closing_speed_mps"),
    "time_to_impact_hindsight_s": ("time_to_impact_s", "true_time_to_impact_s"),
}
"""For each error by hindsight the estimate and its truth, or the error against truth alone."""
_ABOUT: Final = "answered %: share of the errors against truth; ratios are hindsight / truth of the absolute errors"


def hindsight_table(frames: Frames) -> Table:
    """A row for each error by hindsight where the error against truth is known, too; maybe none.

    Raises:
        TableError: a table cannot be read.
    """
    names = [name for later, pair in _OF_FRAMES.items() for name in (later, *pair) if name]
    rows = [*_rows(frames.beside(names), _OF_FRAMES), *_rows(kept_objects(frames), _OF_OBJECTS)]
    return Table("Hindsight", ("answered %", "correlation", "median ratio", "p95 ratio"), rows, (_ABOUT,))


def _rows(table: pl.DataFrame, columns: Mapping[str, tuple[str, str | None]]) -> Iterator[Row]:
    if not table.height:
        return
    for name, (estimate, truth) in columns.items():
        later, true = (table[column].cast(pl.Float64).to_numpy() for column in (name, estimate))
        true = true - (0.0 if truth is None else table[truth].cast(pl.Float64).to_numpy())
        known = np.isfinite(true)
        both = known & np.isfinite(later)
        if np.count_nonzero(both) >= _FEWEST:
            answered = percent(np.count_nonzero(both) / np.count_nonzero(known))
            yield (name, answered, *_figures(later[both], true[both]))


def _figures(later: Float, true: Float) -> Iterator[str]:
    """Correlation, and the ratios of median and p95; empty where undefined."""
    spread = float(later.std() * true.std())
    yield f"{np.mean((later - later.mean()) * (true - true.mean())) / spread:.2f}" if spread > 0 else ""
    for share in (0.5, 0.95):
        of_truth = float(np.quantile(np.abs(true), share))
        yield f"{np.quantile(np.abs(later), share) / of_truth:.2f}" if of_truth > 0 else ""
