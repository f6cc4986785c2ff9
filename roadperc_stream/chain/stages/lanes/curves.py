"""Lane boundaries on the road: from edge pixels to offset, heading and curvature in the ego frame.

The boundary is the edge that faces the ego lane. Both edges of a marking lie within a few centimetres, and so does the
second line of a double one, so only pixels whose neighbour towards the ego lane is road are used, and of several
parallel edges the innermost well supported one. The fit is y = offset + heading x + curvature x^2 / 2, by iteratively
reweighted least squares (Huber's weights, Holland and Welsch 1977), reaching farther ahead step by step so that a bend
is followed from the straight part near the car.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.lanes.sides import outward
from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import Image, Mask, Side
from roadperc_stream.core.geometry import Float

_REACH_STEP_M = 6.0
_SHORTEST_M = 0.25
"""Length on the road from which a line has a direction: the nearest 100 rows of 960 show less than half a metre."""
_FRINGE_PX = 4
"""Foreign pixels between a separator and the road that compression leaves there."""
_SEARCH_M = 0.6
"""Half width of the strip around a Hough line in which edges are searched."""
_BIN_M = 0.04
_PEAK_SHARE = 0.4
"""Support of the innermost edge, as a share of the best supported one, from which it counts as the boundary."""
_BLOB_VARIANCE = 5.0
_BLOB_ANGLE = 0.0125
"""Variance of a fit, by that which its edges promise, where tags err: what is left of a boundary is not all there. It
grows with the square of the edges' angle beyond the second number, radians."""
_MIN_POINTS = 8
_MIN_ROWS = 3
_LEAST_BINS = 3
_REWEIGHTINGS = 5
_GROUND_STD_M = 0.01
_LEAST_SPREAD = 0.67
"""Least mean square of edges' distances from their fit, by their noise: the few of a stretch fit it too well."""
_CURVATURE_PRIOR_PER_M = 0.01
"""Standard deviation of road curvature: where a short stretch does not determine it, the road is close to straight."""
_CORRELATED_ROWS = 24.0
"""Errors of edges in neighbouring rows are correlated: so many edges count as one."""
_NOISE_PX = (1.0, 2.0, 4.0, 8.0, 16.0)
"""How far edges are tried to lie off the boundary, standard deviations: the least that explains them is taken."""
_LOW_PX = 1.0
"""Noise up to which the innermost edge of a row is the boundary's; of more, that is the one that errs most."""
_EXPLAINED = 0.7
_ON_CURVE_STD = 2.5
_STRIP_STD = 3.0
_OUTER_STRIP_STD = 1.5
_FARTHEST_STD_M = 0.3
_PEAK_AT_M = 4.0
_NOISY_PEAK_SHARE = 0.8
_CONTRAST = 3.0
"""Contrast from which edges that err stand for a boundary; blobs of wrong tags alone reach 1 to 2."""
_SURE_CONTRAST = 4.0
"""The same where nothing was known of it before."""
_INSIDE_M = (0.6, 0.8, 1.0, 1.2)
_CHANCE_ROWS = 5.0


@dataclass(frozen=True)
class _Noise:
    """How far edges lie off the boundary, in pixels, and the width of a pixel one metre ahead."""

    edge_px: float
    metres_per_px: float

    def std_m(self, x: Float) -> Float:
        """Standard deviation across the road at distances ahead."""
        result: Float = np.hypot(_GROUND_STD_M, self.edge_px * self.metres_per_px * x)
        return result

    @property
    def is_low(self) -> bool:
        """Whether edges can be told apart by how far inside they lie."""
        return self.edge_px <= _LOW_PX

    @property
    def blob_variance(self) -> float:
        """How many times the variance of a fit is what its edges promise."""
        if self.is_low:
            return 1.0
        return _BLOB_VARIANCE * max(self.edge_px * self.metres_per_px / _BLOB_ANGLE, 1.0) ** 2

    @property
    def reach_m(self) -> float:
        """How far ahead edges say anything."""
        return _FARTHEST_STD_M / (self.edge_px * self.metres_per_px)

    def is_in_strip(self, cfg: LanesConfig, inside_m: Float, x: Float) -> Mask:
        """Edges that may be the boundary's, by how far inside the last fit they lie.

        Of edges that err those farther out count less far: the second line of a double one has them too.
        """
        std = self.std_m(x)
        if self.is_low:
            near: Mask = np.abs(inside_m) < np.maximum(cfg.fit_strip_m, _STRIP_STD * std)
            return near
        between: Mask = (inside_m < _STRIP_STD * std) & (inside_m > -_OUTER_STRIP_STD * std)
        return between


@dataclass(frozen=True)
class Curve:
    """offset (m), heading (rad) and curvature (1/m) at ego x = 0, with (3, 3) covariance."""

    state: Float
    covariance: Float
    reach_m: float
    noise_px: float = 0.0
    """How far the edges lie off it, standard deviation in pixels."""

    contrast: float = np.inf
    """How many times as many edges as the road beside it has."""

    @property
    def is_sure(self) -> bool:
        """Whether it is a boundary, though nothing was known of it before."""
        return self.is_clear or self.contrast >= _SURE_CONTRAST

    @property
    def is_clear(self) -> bool:
        """Whether its edges lie as close to it as those of clean tags."""
        return self.noise_px <= _LOW_PX

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
    if side == "left":
        columns, rows, gap = _facing(marked, drivable[top:])
        return np.stack((columns + 0.5 * (gap + 1), rows + float(top)), axis=-1)
    columns, rows, gap = _facing(marked[:, ::-1], drivable[top:, ::-1])
    return np.stack((marked.shape[1] - 1 - columns - 0.5 * (gap + 1), rows + float(top)), axis=-1)


def _facing(marked: Mask, drivable: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Columns and rows of the last pixels of separators with road to the right, and the foreign pixels between."""
    width = marked.shape[1]
    rows, columns = np.divmod(np.flatnonzero(marked[:, :-1] & ~marked[:, 1:]), width - 1)
    road = drivable & ~marked
    gap = np.full(len(rows), -1)
    for step in range(_FRINGE_PX, -1, -1):
        beyond = np.minimum(columns + 1 + step, width - 1)
        gap[road[rows, beyond]] = step
        gap[marked[rows, beyond]] = -1
    found = gap >= 0
    return columns[found], rows[found], gap[found]


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
    ahead = (points[:, 0] > 0) & (points[:, 0] <= cfg.fit_max_m)
    points, rows = points[ahead], rows[ahead]
    near = np.abs(points[:, 1] - lateral(line, points[:, 0])) < _SEARCH_M
    if np.count_nonzero(near) < _MIN_POINTS or points[near, 0].min() > cfg.near_m:
        return None
    for noise_px in _NOISE_PX:
        noise = _Noise(noise_px, metres_per_px)
        curve = _fit_at(cfg, points, rows, line, side, noise)
        if curve is not None and _explained(curve, points, rows, noise) >= _EXPLAINED:
            curve = replace(curve, contrast=_contrast(curve, points, rows, side, noise))
            return _without_clutter(curve, side, noise) if curve.is_clear or curve.contrast >= _CONTRAST else None
    return None


def _without_clutter(curve: Curve, side: Side, noise: _Noise) -> Curve:
    """The curve as far out as it lies without the edges of wrong tags, which the strip takes from inside more than out.

    Of edges that are spread evenly over the strip, and move with it from fit to fit, the share is that of the contrast.
    """
    if noise.is_low:
        return curve
    between_std = (_STRIP_STD - _OUTER_STRIP_STD) / 2
    aside_std = between_std * (_STRIP_STD + _OUTER_STRIP_STD) / 2 / (curve.contrast - 1.0)
    turned = outward(side) * aside_std * noise.edge_px * noise.metres_per_px
    return replace(curve, state=curve.state + np.array([0.0, turned, 0.0]))


def _fit_at(cfg: LanesConfig, points: Float, rows: Float, line: Float, side: Side, noise: _Noise) -> Curve | None:
    """The boundary near a line where edges err as much as the noise says."""
    inward = -outward(side)
    near = points[np.abs(points[:, 1] - lateral(line, points[:, 0])) < _SEARCH_M]
    reach = near[:, 0].min() + 2 * _REACH_STEP_M
    state = line + np.array([inward * _best_aside(near[near[:, 0] <= reach], line, inward, noise), 0.0, 0.0])
    farthest = min(cfg.fit_max_m, max(noise.reach_m, near[:, 0].min() + _REACH_STEP_M))
    reach = min(reach, farthest)
    while True:
        aside = inward * (points[:, 1] - lateral(state, points[:, 0]))
        strip = (points[:, 0] <= reach) & noise.is_in_strip(cfg, aside, points[:, 0])
        chosen = np.flatnonzero(strip)
        if noise.is_low:
            chosen = chosen[_innermost_of_rows(rows[strip], aside[strip])]
        if len(chosen) < _MIN_POINTS or _rows_in(rows, chosen) < _MIN_ROWS:
            return None
        state, covariance = _robust_fit(cfg, points[chosen], rows[chosen], state, noise)
        if reach >= farthest:
            return Curve(state, covariance, float(points[chosen, 0].max()), noise.edge_px)
        reach = min(reach + _REACH_STEP_M, farthest)


def _explained(curve: Curve, points: Float, rows: Float, noise: _Noise) -> float:
    """Share of the rows with edges near a curve in which one lies on it."""
    aside = np.abs(points[:, 1] - curve.y(points[:, 0]))
    ahead = points[:, 0] <= curve.reach_m
    on_it = _rows_in(rows, ahead & (aside < _ON_CURVE_STD * noise.std_m(points[:, 0])))
    return on_it / max(_rows_in(rows, ahead & (aside < _SEARCH_M)), 1)


def _contrast(curve: Curve, points: Float, rows: Float, side: Side, noise: _Noise) -> float:
    """How many times as many rows have an edge on the curve as have one farther inside, where the road is."""
    inside = -outward(side) * (points[:, 1] - curve.y(points[:, 0]))
    ahead, std = points[:, 0] <= curve.reach_m, noise.std_m(points[:, 0])
    found = [_rows_in(rows, ahead & (np.abs(inside - aside_m) < std)) for aside_m in (0.0, *_INSIDE_M)]
    return found[0] / (float(np.mean(found[1:])) + _CHANCE_ROWS)


def _rows_in(rows: Float, chosen: Mask | NDArray[np.intp]) -> int:
    """How many rows the chosen edges lie in."""
    return int(np.count_nonzero(np.bincount(rows[chosen].astype(np.intp))))


def _best_aside(points: Float, line: Float, inward: float, noise: _Noise) -> float:
    """How far inside the line, in metres, the innermost well supported parallel edge lies."""
    aside = inward * (points[:, 1] - lateral(line, points[:, 0]))
    bin_m = min(max(_BIN_M, float(noise.std_m(np.array(_PEAK_AT_M)))), 2 * _SEARCH_M / _LEAST_BINS)
    edges = np.arange(-_SEARCH_M, _SEARCH_M + bin_m, bin_m)
    counts = np.convolve(np.histogram(aside, edges)[0], np.ones(3), "same")
    peaks = np.flatnonzero((counts >= np.roll(counts, 1)) & (counts >= np.roll(counts, -1)))
    strong = peaks[counts[peaks] >= (_PEAK_SHARE if noise.is_low else _NOISY_PEAK_SHARE) * counts.max()]
    return float(edges[strong[-1]] + bin_m / 2)


def _innermost_of_rows(rows: Float, aside: Float) -> NDArray[np.intp]:
    """Positions of the innermost edge of each row: the second line of a double one has edges that face inward too."""
    order = np.lexsort((-aside, rows))
    _, first = np.unique(rows[order], return_index=True)
    return order[first]


def _robust_fit(cfg: LanesConfig, points: Float, rows: Float, start: Float, noise: _Noise) -> tuple[Float, Float]:
    """(3,) state and (3, 3) covariance of a quadratic through (N, 2) points; edges of a row share its weight."""
    x, y = points.T
    std = noise.std_m(x)
    _, row, count = np.unique(rows, return_inverse=True, return_counts=True)
    design = np.stack((np.ones_like(x), x, 0.5 * x**2), axis=-1)
    prior = np.diag([0.0, 0.0, _CURVATURE_PRIOR_PER_M**-2])
    state = start
    for _ in range(_REWEIGHTINGS):
        residual = np.abs(y - design @ state) / std
        weight = 1.0 / (std**2 * np.maximum(residual / cfg.fit_huber, 1.0) * count[row])
        weighted = design * weight[:, None] / _CORRELATED_ROWS
        information = weighted.T @ design + prior
        state = np.linalg.solve(information, weighted.T @ y)
    spread = float(np.average(((y - design @ state) / std) ** 2, weights=weight))
    scale = max(spread, _LEAST_SPREAD) * noise.blob_variance
    # However close edges lie to a line, how roads bend is not better known.
    return state, np.linalg.inv((information - prior) / scale + prior / max(scale, 1.0))
