"""The functions of ``lanes_compiled`` in numpy: fits of y = s0 + s1 x + s2 x^2 / 2 to points beside a lane line.

The method is iteratively reweighted least squares with Huber's weights (Holland and Welsch, Robust regression using
iteratively reweighted least-squares, 1977). L D L^T solves the normal equations. Sums go from the first point to the
last, so both forms give the same bits.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Rows = NDArray[np.int64]
State = tuple[float, float, float]
Information = tuple[float, float, float, float, float, float]
_REWEIGHTINGS = 5
_ROUNDING = 1e-9
"""Share of a sum of squares below which a remainder is only a rounding error."""


@dataclass(frozen=True)
class Points:
    """(N,) points: metres ahead ``x`` and to the left ``y``, the standard deviation of y, and ascending image rows.

    A point belongs to a quadratic if it lies less than ``inside`` inwards of it, or less than ``outside`` outwards.
    """

    x: Numbers
    y: Numbers
    std: Numbers
    rows: Rows
    inside: Numbers
    outside: Numbers


@dataclass(frozen=True)
class Following:
    """The range of the fits: the first one up to x = ``reach``, each next one a ``step`` farther, up to ``farthest``.

    Inwards is towards larger y if ``inward`` is 1, towards smaller y if it is -1. With ``innermost`` only the innermost
    point of each image row counts (the first of equal ones); otherwise the points of a row share one weight. A fit
    needs ``least_points`` in ``least_rows``.
    """

    inward: float
    reach: float
    step: float
    farthest: float
    innermost: bool
    least_points: int
    least_rows: int


@dataclass(frozen=True)
class Weighing:
    """The weights: Huber's beyond ``huber`` standard deviations, divided by the number ``alike`` of equal errors.

    ``prior`` is additional information on the quadratic's s2.
    """

    huber: float
    alike: float
    prior: float


@dataclass(frozen=True)
class Quadratic:
    """s0, s1 and s2, the information of the points on them (00, 01, 02, 11, 12, 22), and their largest x.

    ``spread`` is the mean weighted squared residual in standard deviations.
    """

    state: State
    information: Information
    spread: float
    reached: float


def follow(points: Points, first: State, following: Following, weighing: Weighing) -> Quadratic | None:
    """The quadratic through the points near ``first``, extended step by step to points farther ahead.

    None if too few points lie near a quadratic or do not determine the next one.
    """
    state, reach = first, following.reach
    while True:
        chosen = _chosen(points, state, following, reach)
        in_row = np.bincount(chosen.rows)
        if len(chosen.rows) < following.least_points or np.count_nonzero(in_row) < following.least_rows:
            return None
        fit = _fitted(chosen, in_row[chosen.rows].astype(np.float64), state, weighing)
        if fit is None or reach >= following.farthest:
            return fit
        state, reach = fit.state, min(reach + following.step, following.farthest)


def _chosen(points: Points, state: State, following: Following, reach: float) -> Points:
    """The points near a quadratic."""
    aside = following.inward * (points.y - _at(state, points.x))
    at = np.flatnonzero((points.x <= reach) & (aside < points.inside) & (aside > -points.outside))
    if following.innermost:
        at = at[_innermost_of_rows(points.rows[at], aside[at])]
    return Points(*(getattr(points, column.name)[at] for column in fields(points)))


def _at(state: State, x: Numbers) -> Numbers:
    s0, s1, s2 = state
    y: Numbers = s0 + s1 * x + 0.5 * s2 * x**2
    return y


def _innermost_of_rows(rows: Rows, aside: Numbers) -> NDArray[np.intp]:
    """Positions of the innermost point of each row."""
    order = np.lexsort((-aside, rows))
    positions: NDArray[np.intp] = order[np.flatnonzero(np.diff(rows[order], prepend=-1))]
    return positions


def _fitted(points: Points, in_row: Numbers, state: State, weighing: Weighing) -> Quadratic | None:
    """The robust fit to (N,) points with (N,) ``in_row`` points in their rows, reweighted from a first state."""
    x, y, std = points.x, points.y, points.std
    q = 0.5 * x**2
    for _ in range(_REWEIGHTINGS):
        off = np.abs(y - _at(state, x)) / std / weighing.huber
        weight = 1.0 / (std * std * np.maximum(off, 1.0) * in_row)
        w = weight / weighing.alike
        wx, wq = w * x, w * q
        sums = _sums(w, wx, wq, wx * x, wx * q, wq * q, w * y, wx * y, wq * y)
        solved = _solved(sums, weighing.prior)
        if solved is None:
            return None
        state = solved
    off = (y - _at(state, x)) / std
    squares, weights = _sums(off * off * weight, weight)
    one, along, square, xx, xq, qq = sums[:6]
    return Quadratic(state, (one, along, square, xx, xq, qq), squares / weights, float(x.max()))


def _sums(*terms: Numbers) -> list[float]:
    """The sum of each array from first to last; np.sum adds in another order."""
    sums: list[float] = (np.cumsum(terms, axis=1)[:, -1] + 0.0).tolist()  # a sum that begins with 0 is never -0
    return sums


def _solved(sums: list[float], prior: float) -> State | None:
    """The solution of the normal equations; None if the points do not determine it."""
    one, x, q, xx, xq, qq, y, xy, qy = sums
    if not one > 0:
        return None
    by_x, by_q = x / one, q / one
    xx, xq = xx - by_x * x, xq - by_x * q
    if not xx > _ROUNDING * sums[3]:
        return None
    by_xq = xq / xx
    qq = (qq + prior) - by_q * q - by_xq * xq
    if not qq > _ROUNDING * (sums[5] + prior):
        return None
    y1 = xy - by_x * y
    s2 = (qy - by_q * y - by_xq * y1) / qq
    s1 = (y1 - xq * s2) / xx
    return (y - x * s1 - q * s2) / one, s1, s2
