"""Lane boundaries on the road: from edge pixels to offset, heading and curvature in the ego frame.

The boundary is the edge that faces the ego lane. Both edges of a marking lie within a few centimetres, and so does the
second line of a double one, so only pixels whose neighbour towards the ego lane is road are used, and of several
parallel edges the innermost well supported one. The fit is y = offset + heading x + curvature x^2 / 2, by iteratively
reweighted least squares (Huber's weights, Holland and Welsch 1977), reaching farther ahead step by step so that a bend
is followed from the straight part near the car.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import Image, Mask, Side
from roadperc_stream.core.geometry import Float

_REACH_STEP_M = 6.0
_SHORTEST_M = 0.25
"""Length on the road from which a line has a direction: the nearest 100 rows of 960 show less than half a metre."""
_SEARCH_M = 0.6
"""Half width of the strip around a Hough line in which edges are searched."""
_BIN_M = 0.04
_PEAK_SHARE = 0.4
"""Support of the innermost edge, as a share of the best supported one, from which it counts as the boundary."""
_MIN_POINTS = 8
_REWEIGHTINGS = 5
_EDGE_STD_PX = 1.0
_GROUND_STD_M = 0.01
_CURVATURE_PRIOR_PER_M = 0.01
"""Standard deviation of road curvature: where a short stretch does not determine it, the road is close to straight."""
_CORRELATED_ROWS = 40.0
"""Errors of edges in neighbouring rows are correlated: so many edges count as one."""


@dataclass(frozen=True)
class Curve:
    """offset (m), heading (rad) and curvature (1/m) at ego x = 0, with (3, 3) covariance."""

    state: Float
    covariance: Float
    reach_m: float

    def y(self, x: Float) -> Float:
        """Lateral position in metres at distances ahead."""
        return lateral(self.state, x)


def lateral(state: Float, x: Float) -> Float:
    """Lateral position of (offset, heading, curvature) at x, metres in the ego frame."""
    result: Float = state[0] + state[1] * x + 0.5 * state[2] * x**2
    return result


def facing_edges(separators: Image, drivable: Mask, side: Side, top: int) -> Float:
    """(N, 2) pixels on the edge between a separator and the road beside it, towards the ego lane.

    Args:
        separators: (H - top, W) uint8 from row ``top`` down, not 0 at separators.
        drivable: (H, W) drivable surface.
        side: the boundary's side: a left one faces right.
        top: the first row evaluated.
    """
    marked = separators.view(bool)
    inner = drivable[top:] & ~marked
    step = marked[:, :-1] & inner[:, 1:] if side == "left" else inner[:, :-1] & marked[:, 1:]
    rows, columns = np.divmod(np.flatnonzero(step), step.shape[1])
    return np.stack((columns + 0.5, rows + float(top)), axis=-1)


def line_on_ground(points: Float) -> Float | None:
    """(offset, heading, 0) of an image line from (N, 3) ego points along it; None where it is not on the road."""
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2 or np.ptp(points[:, 0]) < _SHORTEST_M:
        return None
    near = points[points[:, 0] <= points[:, 0].min() + 2 * _REACH_STEP_M]
    heading, offset = np.polyfit(near[:, 0], near[:, 1], 1)
    return np.array([offset, heading, 0.0])


def fit_curve(
    cfg: LanesConfig, points: Float, rows: Float, line: Float, side: Side, metres_per_px: float
) -> Curve | None:
    """The boundary near a line, from edge points on the ground.

    Args:
        cfg: reach and robustness.
        points: (N, 2) x, y in metres of edges that face the ego lane, ego frame.
        rows: (N,) the image row of each.
        line: (3,) where the Hough line has it.
        side: the boundary's side.
        metres_per_px: width of a pixel one metre ahead.

    Returns:
        The curve, or None where too few edges support it.
    """
    inward = -1.0 if side == "left" else 1.0
    ahead = (points[:, 0] > 0) & (points[:, 0] <= cfg.fit_max_m)
    points, rows = points[ahead], rows[ahead]
    near = points[np.abs(points[:, 1] - lateral(line, points[:, 0])) < _SEARCH_M]
    if len(near) < _MIN_POINTS or near[:, 0].min() > cfg.near_m:
        return None
    reach = near[:, 0].min() + 2 * _REACH_STEP_M
    state = line + np.array([inward * _innermost(near[near[:, 0] <= reach], line, inward), 0.0, 0.0])
    while True:
        aside = inward * (points[:, 1] - lateral(state, points[:, 0]))
        strip = (points[:, 0] <= reach) & (np.abs(aside) < cfg.fit_strip_m)
        inliers = points[strip][_innermost_of_rows(rows[strip], aside[strip])]
        if len(inliers) < _MIN_POINTS:
            return None
        state, covariance = _robust_fit(cfg, inliers, state, metres_per_px)
        if reach >= cfg.fit_max_m:
            return Curve(state, covariance, float(inliers[:, 0].max()))
        reach = min(reach + _REACH_STEP_M, cfg.fit_max_m)


def _innermost(points: Float, line: Float, inward: float) -> float:
    """How far inside the line, in metres, the innermost well supported parallel edge lies."""
    aside = inward * (points[:, 1] - lateral(line, points[:, 0]))
    edges = np.arange(-_SEARCH_M, _SEARCH_M + _BIN_M, _BIN_M)
    counts = np.convolve(np.histogram(aside, edges)[0], np.ones(3), "same")
    peaks = np.flatnonzero((counts >= np.roll(counts, 1)) & (counts >= np.roll(counts, -1)))
    strong = peaks[counts[peaks] >= _PEAK_SHARE * counts.max()]
    return float(edges[strong[-1]] + _BIN_M / 2)


def _innermost_of_rows(rows: Float, aside: Float) -> NDArray[np.intp]:
    """Positions of the innermost edge of each row: the second line of a double one has edges that face inward too."""
    order = np.lexsort((-aside, rows))
    _, first = np.unique(rows[order], return_index=True)
    return order[first]


def _robust_fit(cfg: LanesConfig, points: Float, start: Float, metres_per_px: float) -> tuple[Float, Float]:
    """(3,) state and (3, 3) covariance of a quadratic through (N, 2) points."""
    x, y = points.T
    std = np.hypot(_GROUND_STD_M, _EDGE_STD_PX * metres_per_px * x)
    design = np.stack((np.ones_like(x), x, 0.5 * x**2), axis=-1)
    prior = np.diag([0.0, 0.0, _CURVATURE_PRIOR_PER_M**-2])
    state = start
    for _ in range(_REWEIGHTINGS):
        residual = np.abs(y - design @ state) / std
        weight = 1.0 / (std**2 * np.maximum(residual / cfg.fit_huber, 1.0))
        weighted = design * weight[:, None] / _CORRELATED_ROWS
        information = weighted.T @ design + prior
        state = np.linalg.solve(information, weighted.T @ y)
    return state, np.linalg.inv(information)
