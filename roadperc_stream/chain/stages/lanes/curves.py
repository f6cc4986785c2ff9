"""Lane boundaries on the road: from edge pixels to offset, heading and curvature in the ego frame.

The boundary is the edge that faces the ego lane. The other edge of its marking, or a second line, is only centimetres
away. So the fit uses only pixels whose neighbour towards the ego lane is road, and the innermost well supported edge of
several parallel ones. The robust fit is y = offset + heading x + curvature x^2 / 2. It extends ahead step by step, from
the straight part near the car into a bend.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import LanesConfig
from roadperc_stream.geometry import Float
from roadperc_stream.kernels import follow
from roadperc_stream.kernels.lanes_plain import Following, Points, Quadratic, Weighing
from roadperc_stream.model import Mask, Side

_REACH_STEP_M = 6.0
NEAR_M = 15.0
"""Largest distance ahead (ego x) of a boundary's nearest support."""
FIT_MAX_M = 40.0
"""Farthest point of a fit: beyond it, a pixel spans a metre of road or more."""
_FIT_HUBER = 2.0
"""Standard deviations beyond which the weight of an edge decreases (Huber's constant)."""
_SHORTEST_M = 0.25
"""Minimum length of a line on the road: the nearest 100 rows of 960 show less than half a metre."""
_SEARCH_M = 0.6
"""Half width of the strip around a Hough line in which edges are searched."""
_BIN_M = 0.04
_PEAK_SHARE = 0.4
"""The innermost edge is the boundary if its support is at least this share of the largest support of an edge."""
_BLOB_VARIANCE = 5.0
_BLOB_ANGLE = 0.0125
"""Factor of a fit's variance over that of its edges with wrong tags. Beyond the second number, radians, it grows with
the square of the edges' angle."""
_MIN_POINTS = 8
_MIN_ROWS = 3
_LEAST_BINS = 3
_GROUND_STD_M = 0.01
_LEAST_SPREAD = 0.67
"""Minimum mean square of the edges' normalised residuals, because a fit to few edges has too small residuals."""
_CURVATURE_INFORMATION = 0.01**-2
"""Prior inverse variance of road curvature: a short stretch does not determine it, and roads are nearly straight."""
_CORRELATED_ROWS = 24.0
"""Errors of edges in neighbouring rows are correlated: this many edges count as one."""
_NOISE_PX = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Tried standard deviations of the edges' noise; the smallest one that explains the edges counts."""
_LOW_PX = 1.0
"""Largest noise at which the innermost edge of a row is the boundary's; with more noise it has the largest error."""
_EXPLAINED = 0.7
_ON_CURVE_STD = 2.5
_STRIP_STD = 3.0
_OUTER_STRIP_STD = 1.5
_FARTHEST_STD_M = 0.3
_PEAK_AT_M = 4.0
_NOISY_PEAK_SHARE = 0.8
_CONTRAST = 3.0
"""Least contrast of a boundary with noisy edges; blobs of wrong tags reach 1 to 2."""
_SURE_CONTRAST = 4.0
"""Least contrast of a new boundary with noisy edges."""
_INSIDE_M = (0.6, 0.8, 1.0, 1.2)
_CHANCE_ROWS = 5.0


@dataclass(frozen=True)
class Edges:
    """Edges on the ground that face the ego lane from one side: (N,) x and y in metres in the ego frame, image rows.

    Only edges up to ``FIT_MAX_M`` ahead, sorted by row. They were searched in every ``row_step``-th row.
    """

    x: Float
    y: Float
    rows: NDArray[np.int64]
    row_step: int = 1

    @classmethod
    def of(cls, points: Float, rows: Float, row_step: int = 1) -> "Edges":
        """Edges from (N, 2) points and the image row of each; NaN points are left out."""
        ahead = np.flatnonzero((points[:, 0] > 0) & (points[:, 0] <= FIT_MAX_M) & np.isfinite(points[:, 1]))
        ahead = ahead[np.argsort(rows[ahead], kind="stable")]
        x, y = np.ascontiguousarray(points[ahead].T)
        return cls(x, y, rows[ahead].astype(np.int64), row_step)


@dataclass(frozen=True)
class _Noise:
    """The noise of the edges in pixels, and the width of a pixel one metre ahead."""

    edge_px: float
    metres_per_px: float

    def std_m(self, x: Float) -> Float:
        """Standard deviation across the road at distances ahead."""
        result: Float = np.hypot(_GROUND_STD_M, self.edge_px * self.metres_per_px * x)
        return result

    @property
    def is_low(self) -> bool:
        """Whether the noise is low enough to separate parallel edges."""
        return self.edge_px <= _LOW_PX

    @property
    def blob_variance(self) -> float:
        """Factor of a fit's variance over that of its edges."""
        if self.is_low:
            return 1.0
        return _BLOB_VARIANCE * max(self.edge_px * self.metres_per_px / _BLOB_ANGLE, 1.0) ** 2

    @property
    def reach_m(self) -> float:
        """Distance ahead up to which edges are useful."""
        return _FARTHEST_STD_M / (self.edge_px * self.metres_per_px)

    def strip_m(self, cfg: LanesConfig, std_m: Float) -> tuple[Float, Float]:
        """The distances inside and outside the last fit within which edges may be the boundary's.

        The outer strip of noisy edges is narrower: the second line of a double marking lies there.
        """
        inside_m = _STRIP_STD * std_m
        if self.is_low:
            inside_m = np.maximum(cfg.fit_strip_m, inside_m)
            return inside_m, inside_m
        return inside_m, _OUTER_STRIP_STD * std_m


@dataclass(frozen=True)
class Curve:
    """offset (m), heading (rad) and curvature (1/m) at ego x = 0, with (3, 3) covariance.

    ``per_slope`` (3,) is the derivative of the fitted ``state`` by the slope of the curvature (1/m²), which the fit
    does not estimate.
    """

    state: Float
    covariance: Float
    reach_m: float
    per_slope: Float = field(default_factory=lambda: np.zeros(3))
    noise_px: float = 0.0
    """Standard deviation of the edges from the curve, pixels."""

    contrast: float = np.inf
    """Ratio of its edges to those of the road beside it."""

    @property
    def is_sure(self) -> bool:
        """Whether it can start a new boundary."""
        return self.is_clear or self.contrast >= _SURE_CONTRAST

    @property
    def is_clear(self) -> bool:
        """Whether its edges lie as close to it as those of clean tags."""
        return self.noise_px <= _LOW_PX


def other_side(side: Side) -> Side:
    """The opposite side."""
    return "right" if side == "left" else "left"


def outward(side: Side) -> float:
    """Sign of y on that side of the car."""
    return 1.0 if side == "left" else -1.0


def lateral(state: Float, x: Float) -> Float:
    """Lateral position of (offset, heading, curvature) at x, metres in the ego frame."""
    result: Float = state[0] + state[1] * x + 0.5 * state[2] * x**2
    return result


def line_on_ground(points: Float) -> Float | None:
    """(offset, heading, 0) of an image line from (N, 3) ego points along it; None if it is not on the road."""
    points = points[np.isfinite(points).all(axis=1), :2]
    near = points[points[:, 0] <= points[:, 0].min(initial=np.inf) + 2 * _REACH_STEP_M]
    if len(near) < 2 or np.ptp(near[:, 0]) < _SHORTEST_M:
        return None
    middle = near.mean(axis=0)
    x, y = (near - middle).T
    heading = float(x @ y) / float(x @ x)
    return np.array([middle[1] - heading * middle[0], heading, 0.0])


def fit_curve(
    cfg: LanesConfig, edges: Edges, line: Float, side: Side, metres_per_px: float, near_m: float = NEAR_M
) -> Curve | None:
    """The boundary near a line, from the edges of its side on the ground; None if too few edges support it.

    ``line`` is the (3,) state of the Hough line, ``metres_per_px`` the width of a pixel one metre ahead.
    ``near_m`` is the largest distance ahead of its nearest edge.
    """
    near = np.abs(edges.y - lateral(line, edges.x)) < _SEARCH_M
    if np.count_nonzero(near) < _MIN_POINTS or edges.x[near].min() > near_m:
        return None
    for noise_px in _NOISE_PX:
        noise = _Noise(noise_px, metres_per_px)
        std_m = noise.std_m(edges.x)
        curve = _fit_at(cfg, edges, near, line, -outward(side), noise, std_m)
        if curve is None:
            continue
        explained, contrast = _support(curve, edges, std_m, side)
        if explained >= _EXPLAINED:
            curve = replace(curve, contrast=contrast)
            return _without_clutter(curve, side, noise) if curve.is_clear or contrast >= _CONTRAST else None
    return None


def _without_clutter(curve: Curve, side: Side, noise: _Noise) -> Curve:
    """The curve moved outwards, to undo the bias of edges from wrong tags: the strip is wider inside than outside.

    These edges are spread evenly over the strip, move with it from fit to fit, and have the share of the contrast.
    """
    if noise.is_low:
        return curve
    between_std = (_STRIP_STD - _OUTER_STRIP_STD) / 2
    aside_std = between_std * (_STRIP_STD + _OUTER_STRIP_STD) / 2 / (curve.contrast - 1.0)
    turned = outward(side) * aside_std * noise.edge_px * noise.metres_per_px
    return replace(curve, state=curve.state + np.array([0.0, turned, 0.0]))


def _fit_at(
    cfg: LanesConfig, edges: Edges, near: Mask, line: Float, inward: float, noise: _Noise, std_m: Float
) -> Curve | None:
    """The boundary near a line, with edges of this noise; ``std_m`` (N,) is that of each edge."""
    nearest_m = float(edges.x[near].min())
    reach = nearest_m + 2 * _REACH_STEP_M
    begin = near & (edges.x <= reach)
    aside = inward * _best_aside(edges.x[begin], edges.y[begin], line, inward, noise)
    offset, heading, curvature = line.tolist()
    farthest = min(FIT_MAX_M, max(noise.reach_m, nearest_m + _REACH_STEP_M))
    limits = Following(inward, min(reach, farthest), _REACH_STEP_M, farthest, noise.is_low, _MIN_POINTS, _MIN_ROWS)
    points = Points(edges.x, edges.y, std_m, edges.rows, *noise.strip_m(cfg, std_m))
    weighing = Weighing(_FIT_HUBER, _CORRELATED_ROWS / edges.row_step, _CURVATURE_INFORMATION)
    fit = follow(points, (offset + aside, heading, curvature), limits, weighing)
    if fit is None:
        return None
    on_it = np.abs(edges.y - lateral(np.array(fit.state), edges.x)) < points.inside
    covariance, per_slope = _covariance_and_slope_effect(fit, noise, edges.x[on_it & (edges.x <= fit.reached)])
    return Curve(np.array(fit.state), covariance, fit.reached, per_slope, noise.edge_px)


def _covariance_and_slope_effect(fit: Quadratic, noise: _Noise, x: Float) -> tuple[Float, Float]:
    """(3, 3) covariance of offset, heading and curvature, from the residuals and the information of edges at (N,) x.

    Then ``Curve.per_slope``, which is the fit of a quadratic to the same edges on x^3 / 6.
    """
    i00, i01, i02, i11, i12, i22 = fit.information
    scale = max(fit.spread, _LEAST_SPREAD) * noise.blob_variance
    known = np.array([[i00, i01, i02], [i01, i11, i12], [i02, i12, i22]]) / scale
    # Small residuals do not make the prior of the curvature sharper.
    known[2, 2] += _CURVATURE_INFORMATION / max(scale, 1.0)
    covariance = np.asarray(np.linalg.inv(known), np.float64)
    # `follow` has sums up to x⁴; x⁵ comes from its ratio to x⁴ over the edges on the curve.
    of_x4 = x**4 / noise.std_m(x) ** 2
    x3, x4 = 2 * i12, 4 * i22
    x5 = x4 * float(of_x4 @ x) / float(of_x4.sum())
    return covariance, covariance @ (np.array([x3 / 6, x4 / 6, x5 / 12]) / scale)


def _support(curve: Curve, edges: Edges, std_m: Float, side: Side) -> tuple[float, float]:
    """Share of the rows with edges near a curve in which one lies on it, and the curve's contrast.

    The contrast is the ratio of the rows with an edge on the curve to those with an edge farther inside, on the road.
    """
    inside_m = -outward(side) * (edges.y - lateral(curve.state, edges.x))
    inside_m[edges.x > curve.reach_m] = np.nan  # not near any line
    explained, around = (
        _rows_near(inside_m, edges.rows, 0.0, within_m) for within_m in (_ON_CURVE_STD * std_m, _SEARCH_M)
    )
    on_it, *inside = (_rows_near(inside_m, edges.rows, line_m, std_m) for line_m in (0.0, *_INSIDE_M))
    return explained / max(around, 1), on_it / (sum(inside) / len(inside) + _CHANCE_ROWS)


def _rows_near(inside_m: Float, rows: NDArray[np.int64], line_m: float, within_m: Float | float) -> int:
    """Number of rows, (N,) ascending, with an edge near a line at this distance inside the curve."""
    near = rows[np.abs(inside_m - line_m) < within_m]
    return int(np.count_nonzero(near[1:] != near[:-1])) + min(len(near), 1)


def _best_aside(x: Float, y: Float, line: Float, inward: float, noise: _Noise) -> float:
    """Distance of the innermost well supported parallel edge inside the line, metres."""
    bin_m = min(max(_BIN_M, float(noise.std_m(np.array(_PEAK_AT_M)))), 2 * _SEARCH_M / _LEAST_BINS)
    edges = np.arange(-_SEARCH_M, _SEARCH_M + bin_m, bin_m)
    ordered = np.sort(inward * (y - lateral(line, x)))
    below = ordered.searchsorted(edges)
    below[-1] = ordered.searchsorted(edges[-1], "right")
    counts = [0, *np.diff(below).tolist(), 0]
    support = [sum(counts[at - 1 : at + 2]) for at in range(1, len(counts) - 1)]
    least = (_PEAK_SHARE if noise.is_low else _NOISY_PEAK_SHARE) * max(support)
    # The first and last bins count as neighbours, too.
    after = (*support[1:], support[0])
    strong = [at for at, here in enumerate(support) if here >= max(support[at - 1], after[at]) and here >= least]
    return float(edges[strong[-1]] + bin_m / 2)
