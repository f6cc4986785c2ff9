"""How far hindsight can be believed: its errors beside those against truth, on the same frames."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.output.text_table import Row, Table

from ..report_columns import HINDSIGHT, TRUTH, TRUTH_OF, percent
from .sources import Frames

_FEWEST: Final = 10
_NEARING: Final = "near 0"
_ABOUT: Final = "on frames with both errors; ratios are hindsight / truth of the absolute errors"


def hindsight_table(frames: Frames) -> Table:
    """A row for each error by hindsight on whose frames the error against truth is known, too; maybe none.

    Raises:
        TableError: a table cannot be read.
    """
    values = dict(frames.columns({*TRUTH_OF, *TRUTH_OF.values()}))
    return Table("Hindsight", ("frames %", "correlation", "median", "p95"), tuple(_rows(values)), (_ABOUT,))


def _rows(values: dict[str, Float]) -> Iterator[Row]:
    signed = {quantity.column for quantity in TRUTH if quantity.better == _NEARING}
    for quantity in HINDSIGHT:
        later, true = values[quantity.column], values[TRUTH_OF[quantity.column]]
        if TRUTH_OF[quantity.column] not in signed:
            later, true = np.abs(later), np.abs(true)
        has_truth, both = np.isfinite(true), np.isfinite(true) & np.isfinite(later)
        if np.count_nonzero(both) < _FEWEST:
            continue
        covered = np.count_nonzero(both) / np.count_nonzero(has_truth)
        yield (
            quantity.name,
            percent(covered),
            _correlation(later[both], true[both]),
            *_ratios(later[both], true[both]),
        )


def _correlation(later: Float, true: Float) -> str:
    spreads = float(later.std()) * float(true.std())
    return f"{np.mean((later - later.mean()) * (true - true.mean())) / spreads:.2f}" if spreads > 0 else ""


def _ratios(later: Float, true: Float) -> Iterator[str]:
    for share in (0.5, 0.95):
        of_truth = float(np.quantile(np.abs(true), share))
        yield f"{np.quantile(np.abs(later), share) / of_truth:.2f}" if of_truth > 0 else ""
