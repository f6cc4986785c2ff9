"""The lag of an estimate behind its truth, in frames, from their correlations."""

import math
from collections.abc import Iterable, Sequence
from typing import Final

import polars as pl

from ..report_columns import TRACED
from ..scan import before

_FARTHEST: Final = 6
_SHIFTS: Final = tuple(sorted(range(-_FARTHEST, _FARTHEST + 1), key=abs))
"""Tried lags, in frames, the smallest first; among equally good lags the smallest one is chosen."""
_FOLLOWS: Final = 0.5
"""Smallest correlation of an estimate that follows its truth; on a straight road it is lower."""
_DISTINCT: Final = 1.25
"""Minimum ratio between the unexplained variance at other lags and that at the reported lag."""
_ROUNDING: Final = 1e-9
_FEWEST: Final = 3
"""Fewest frames for a correlation; two columns of fewer frames always correlate."""


def correlations(estimate: str, truth: str) -> pl.Expr:
    """Pearson's coefficients of two columns, a list with one for each of ``_SHIFTS``, over frames with both values.

    A coefficient is null if fewer than half of the frames have both values, and NaN if one column is constant.
    """
    return pl.concat_list(_correlation(before(pl.col(estimate), -shift), pl.col(truth)) for shift in _SHIFTS)


def traces() -> list[pl.Expr]:
    """Correlations of each side's smoothed offset with its truth."""
    return [correlations(*columns).alias(side) for side, columns in TRACED.items()]


def _correlation(a: pl.Expr, b: pl.Expr) -> pl.Expr:
    enough = (a.is_not_null() & b.is_not_null()).sum() >= pl.max_horizontal(pl.len() / 2, _FEWEST)
    return pl.when(enough).then(pl.corr(a, b))  # over the frames where both are known


def lag_frames(coefficients: Sequence[float | None]) -> int | None:
    """Frames by which an estimate lags its truth: the shift with the largest of ``correlations``.

    None if the largest is at the end of the shifts, since a larger one may lie beyond. Also None if no shift is
    distinct: shifts two or more frames away explain almost as much, as on a straight line.
    """
    pairs = zip(coefficients, _SHIFTS, strict=False)
    known = {shift: value for value, shift in pairs if value is not None and math.isfinite(value)}
    shift = max(known, key=lambda k: known[k], default=0)
    unexplained = {k: 1 - value * abs(value) for k, value in known.items()}
    others = min((share for k, share in unexplained.items() if abs(k - shift) > 1), default=math.inf)
    distinct = known.get(shift, 0.0) >= _FOLLOWS and others > _DISTINCT * unexplained[shift] + _ROUNDING
    return shift if distinct and abs(shift) < _FARTHEST else None


def averaged(parts: Iterable[tuple[int, Sequence[float | None]]]) -> tuple[float | None, ...]:
    """Correlations over several tables, weighted by their frames; empty if no table has a lag."""
    lagging = [(frames, coefficients) for frames, coefficients in parts if lag_frames(coefficients) is not None]
    total = sum(frames for frames, _ in lagging)
    weighted = ([frames / total * (c or 0.0) for c in coefficients] for frames, coefficients in lagging)
    return tuple(map(sum, zip(*weighted, strict=True)))
