"""What ``lanes_compiled`` does, in numpy.

y = s0 + s1 x + s2 x^2 / 2 is fitted by iteratively reweighted least squares with Huber's weights (Holland and Welsch,
Robust regression using iteratively reweighted least-squares, 1977). The normal equations are solved by L D L^T, and
sums go from the first point to the last, so that the compiled counterpart has the same bits.
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
"""Share of a sum of squares below which what is left of it is no spread but rounding."""


@dataclass(frozen=True)
class Points:
    """(N,) points: metres along ``x`` and aside ``y``, the standard deviation of y, and image rows, not decreasing.

    A quadratic's are those that lie less than ``inside`` to one side of it, and less than ``outside`` to the other.
    """

    x: Numbers
    y: Numbers
    std: Numbers
    rows: Rows
    inside: Numbers
    outside: Numbers


@dataclass(frozen=True)
class Following:
    """How points are followed: up to x = ``reach``, then a ``step`` farther with each fit, up to ``farthest``.

    The inside is at larger y where ``inward`` is 1, at smaller where it is -1. Of the points of a row the ``innermost``
    alone counts, the first of equal ones, or all share its weight. A fit needs ``least_points`` in ``least_rows``.
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
    """What points say: beyond ``huber`` standard deviations less and less, and of ``alike`` ones the errors are one.

    ``prior`` is the information on the quadratic's s2 besides.
    """

    huber: float
    alike: float
    prior: float


@dataclass(frozen=True)
class Quadratic:
    """s0, s1 and s2; what its points say of them (00, 01, 02, 11, 12, 22), and how far those reach.

    ``spread`` is their mean weighted squared residual in standard deviations.
    """

    state: State
    information: Information
    spread: float
    reached: float


def follow(points: Points, first: State, how: Following, weighing: Weighing) -> Quadratic | None:
    """The quadratic through the points near a first one, and near what fits them farther on.

    None where too few points lie beside a quadratic, or they do not determine the next.
    """
    state, reach = first, how.reach
    while True:
        chosen = _chosen(points, state, how, reach)
        in_row = np.bincount(chosen.rows)
        if len(chosen.rows) < how.least_points or np.count_nonzero(in_row) < how.least_rows:
            return None
        fit = _fitted(chosen, in_row[chosen.rows].astype(np.float64), state, weighing)
        if fit is None or reach >= how.farthest:
            return fit
        state, reach = fit.state, min(reach + how.step, how.farthest)


def rows_beside(
    points: Points, state: State, inward: float, reach: float, asides: tuple[float, ...]
) -> tuple[int, ...]:
    """How many rows have a point up to x = ``reach`` beside the lines that run so far inside of a quadratic."""
    aside = inward * (points.y - _at(state, points.x))
    ahead = points.x <= reach
    beside = (ahead & (aside - line < points.inside) & (aside - line > -points.outside) for line in asides)
    return tuple(int(np.count_nonzero(np.bincount(points.rows[chosen]))) for chosen in beside)


def _chosen(points: Points, state: State, how: Following, reach: float) -> Points:
    """Those beside a quadratic."""
    aside = how.inward * (points.y - _at(state, points.x))
    at = np.flatnonzero((points.x <= reach) & (aside < points.inside) & (aside > -points.outside))
    if how.innermost:
        at = at[_innermost_of_rows(points.rows[at], aside[at])]
    return Points(*(getattr(points, part.name)[at] for part in fields(points)))


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
    """The robust fit to (N,) points of rows of so many, iteratively reweighted from a first one."""
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
    """The sum of each from the first to the last: NumPy's own adds in another order."""
    sums: list[float] = (np.cumsum(terms, axis=1)[:, -1] + 0.0).tolist()  # no sum that begins with 0 ends with -0
    return sums


def _solved(sums: list[float], prior: float) -> State | None:
    """The state of the normal equations; None where the points do not determine it."""
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
