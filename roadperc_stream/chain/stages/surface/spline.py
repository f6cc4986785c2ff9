"""The road as a smooth height field z(x, y) in the ego frame, for roads that climb and fall.

Method: a penalised B-spline (P-spline, Eilers and Marx 1996) is added to the road's plane. It is cubic on evenly spaced
knots along x (de Boor 1978) and linear across y. The penalty on the second differences of its coefficients is a prior
with a standard deviation of the road's curvature. So the scatter of the data decides how smooth the field is, and
without data it continues straight. Iteratively reweighted least squares make the fit robust (Holland and Welsch 1977):
Huber's weights find the road, Tukey's weights then remove objects on it. The fit grows outwards from the car, as far as
the curvature of a road allows. It uses one point of each square metre, the one of median height, because the image has
many pixels near the car and few far ahead. Four B-splines are not 0 at a point, so the normal equations are a band, and
the time to solve them grows linearly with the length of the road.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.surface.plane import NORMAL_MAD, first_row, median, number_of
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.geometry.ground import REACH_M, ego_points, part
from roadperc_stream.kernels import median_places, normal_equations, solve_band
from roadperc_stream.model import HeightGrid, Mask, Surface

DEGREE: Final = 3
"""Degree of the B-splines along x."""
_STEP_M = 1.0
"""Side of the fit's cells and of the grid's cells."""
_COLUMNS = 160
"""Number of used image columns, evenly spread; all rows are used, because far road has few."""
_ENOUGH_POINTS = 20_000
"""Number of points up to which all are used; a lidar has hardly more."""
_SUPPORT = 2 * (DEGREE + 1)
"""Number of coefficients that are not 0 at a point: four B-splines, each with a height and a slope across."""
_MIN_CELLS = 12
_MIN_LENGTH_KNOTS = 2
"""Minimum length of a field in knots."""
_BANK_STD = 0.03
"""Standard deviation of the field's slope across the road, relative to the plane."""
_POINTS_THAT_COUNT = 4
"""Number of points from which a cell has full weight: the errors of its points are not independent."""
_FINEST_STD_M = 0.005
_HUBER, _TUKEY = 1.345, 4.685
"""Constants in standard deviations, for 95 % efficiency on normal errors."""
_HUBER_ROUNDS, _TUKEY_ROUNDS = 4, 3
_REACH_STEP_M = 10.0
_GATE_M, _GATE_STDS = 0.3, 3.0
"""Largest distance of a cell from the field so far, plus this many standard deviations of the curvature."""


@dataclass(frozen=True)
class _Design:
    """The equations of N points: (N, 8) indices of the coefficients that are not 0, and their (N, 8) factors.

    A B-spline has two neighbouring coefficients: its height on the x axis, and its rise over half the width.
    """

    indices: NDArray[np.intp]
    values: Float

    def take(self, chosen: Mask) -> "_Design":
        """The equations at a mask."""
        return _Design(self.indices[chosen], self.values[chosen])

    def heights(self, coefficients: Float) -> Float:
        """(N,) heights in metres for (P,) coefficients."""
        result: Float = np.sum(self.values * coefficients[self.indices], axis=1)
        return result


def road_cells(
    cfg: SurfaceConfig, surface: Surface, camera: Camera, ego_T_camera: Float, depth_m: Float32, usable: Mask
) -> tuple[Float, Float]:
    """One point of each square metre of the road, up to ``spline_half_width_m`` aside and ``max_depth_m`` ahead.

    It is the point of median height. On a slope, a mean position would not fit a median height. ``depth_m``
    is (H, W) metres, NaN unknown; ``usable`` (H, W) are the pixels of the road with known depth.

    Returns:
        (N, 3) x, y and height above the plane, metres, and (N,) weights, 0 to 1, which grow with a cell's points.
    """
    columns = max(min(camera.width // _COLUMNS, number_of(usable) // _ENOUGH_POINTS), 1)
    top = first_row(usable)
    x, y, z = ego_points(part(camera, 1, columns), ego_T_camera, depth_m[top:, ::columns], top)
    length_m, half_m, step_m = (np.float32(value) for value in (_length_m(cfg), cfg.spline_half_width_m, _STEP_M))
    inside = usable[top:, ::columns] & (x >= 0) & (x < length_m) & (np.abs(y) < half_m)
    x, y, z = x[inside], y[inside], z[inside]
    cells = (x / step_m).astype(np.int32) * np.int32(_cells_across(cfg)) + ((y + half_m) / step_m).astype(np.int32)
    a, b, d = np.array(surface.abd, np.float32)
    points = np.stack((x, y, z - (d - a * x - b * y)))
    # One additional row of cells, because rounding may move y at the left edge into it.
    along = int(np.ceil(_length_m(cfg) / _STEP_M)) + 1
    chosen, counts = median_places(cells, points[2], along * _cells_across(cfg))
    weights = np.minimum(counts, _POINTS_THAT_COUNT) / _POINTS_THAT_COUNT
    return np.ascontiguousarray(points[:, chosen].T, np.float64), weights


def fit_height_grid(cfg: SurfaceConfig, surface: Surface, points: Float, weights: Float) -> HeightGrid | None:
    """The height field on a grid of 1 m through (N, 3) points with (N,) weights, as ``road_cells`` returns them.

    None if the points are too few or their stretch of road is too short.
    """
    if len(points) < _MIN_CELLS or np.ptp(points[:, 0]) < _MIN_LENGTH_KNOTS * cfg.spline_knot_m:
        return None
    return _grid(cfg, surface, _grow(cfg, points, weights))


def _cells_across(cfg: SurfaceConfig) -> int:
    return int(np.ceil(2 * cfg.spline_half_width_m / _STEP_M))


def _length_m(cfg: SurfaceConfig) -> float:
    """Length of the field in metres: whole knots, up to the farthest used point or beyond it."""
    return float(np.ceil(min(cfg.max_depth_m, REACH_M) / cfg.spline_knot_m)) * cfg.spline_knot_m


def _splines(cfg: SurfaceConfig) -> int:
    """Number of B-splines along x."""
    return round(_length_m(cfg) / cfg.spline_knot_m) + DEGREE


def _design(cfg: SurfaceConfig, x: Float, y: Float) -> _Design:
    """The equations of points: values of the B-splines, and the same times y in half widths."""
    first, along = basis(cfg.spline_knot_m, _splines(cfg), np.clip(x, 0.0, _length_m(cfg)))
    across = along * (y / cfg.spline_half_width_m)[:, None]
    return _Design(2 * first[:, None] + np.arange(_SUPPORT), np.stack((along, across), axis=-1).reshape(-1, _SUPPORT))


@lru_cache(maxsize=2)
def _prior(cfg: SurfaceConfig) -> Float:
    """(8, P) information on the coefficients: curvature along x of both kinds, and slope across.

    These are the main diagonal and the diagonals below it, each element at its column.
    """
    count = _splines(cfg)
    bend = np.diff(np.eye(count), 2, axis=0) / (cfg.spline_curvature_per_m * cfg.spline_knot_m**2)
    bank = np.eye(count) / (_BANK_STD * cfg.spline_half_width_m)
    prior = np.zeros((2 * count, 2 * count))
    prior[::2, ::2] = bend.T @ bend
    prior[1::2, 1::2] = bend.T @ bend + bank.T @ bank
    lower = np.zeros((_SUPPORT, 2 * count))
    for beside in range(_SUPPORT):
        lower[beside, : 2 * count - beside] = np.diag(prior, -beside)
    return lower


def _grow(cfg: SurfaceConfig, points: Float, weights: Float) -> Float:
    """(P,) coefficients of the field, fitted step by step farther ahead.

    Each step leaves out points that a road of plausible curvature cannot reach: behind a crest, for example, the
    road has no points that outweigh them.
    """
    x, heights = points[:, 0], points[:, 2]
    design, prior = _design(cfg, x, points[:, 1]), _prior(cfg)
    coefficients: Float = np.zeros(prior.shape[1])
    known_m = float(x.min())
    for reach in np.arange(known_m + _REACH_STEP_M, _length_m(cfg) + _REACH_STEP_M, _REACH_STEP_M):
        bend = _GATE_STDS * cfg.spline_curvature_per_m / 2 * np.maximum(x - known_m, 0.0) ** 2
        inliers = (x <= reach) & (np.abs(heights - design.heights(coefficients)) <= _GATE_M + bend)
        if inliers.any():
            coefficients = _robust_fit(design.take(inliers), heights[inliers], weights[inliers], prior, coefficients)
            known_m = float(x[inliers].max())
    return coefficients


def _robust_fit(design: _Design, heights: Float, weights: Float, prior: Float, coefficients: Float) -> Float:
    """(P,) coefficients by penalised, iteratively reweighted least squares, from (P,) initial ones.

    ``heights`` are (N,) metres, ``prior`` (8, P) as from ``_prior``. Equations without a solution change nothing.
    """
    count = prior.shape[1]
    first = design.indices[:, 0]
    for i in range(_HUBER_ROUNDS + _TUKEY_ROUNDS):
        residual = np.abs(heights - design.heights(coefficients))
        std = max(NORMAL_MAD * median(residual), _FINEST_STD_M)
        off = residual / std
        if i < _HUBER_ROUNDS:
            robust = np.minimum(1.0, _HUBER / np.maximum(off, _HUBER))
        else:
            robust = np.clip(1.0 - (off / _TUKEY) ** 2, 0.0, None) ** 2
        lower, right = normal_equations(first, design.values, robust * weights / std**2, heights, count)
        solution = solve_band(lower + prior, right)
        coefficients = coefficients if solution is None else solution
    return coefficients


def _grid(cfg: SurfaceConfig, surface: Surface, coefficients: Float) -> HeightGrid:
    """The sum of plane and field at the grid's nodes."""
    x, y, design = _nodes(cfg)
    a, b, d = surface.abd
    z = d - a * x - b * y[:, None] + design.heights(coefficients).reshape(len(y), len(x))
    return HeightGrid(0.0, -cfg.spline_half_width_m, _STEP_M, z.astype(np.float32))


@lru_cache(maxsize=2)
def _nodes(cfg: SurfaceConfig) -> tuple[Float, Float, _Design]:
    """The x of the grid's columns, y of its rows, and the equations of all its nodes, row by row."""
    half = cfg.spline_half_width_m
    x, y = np.arange(0.0, _length_m(cfg) + _STEP_M / 2, _STEP_M), np.arange(-half, half + _STEP_M / 2, _STEP_M)
    columns, rows = (values.ravel() for values in np.meshgrid(x, y))
    return x, y, _design(cfg, columns, rows)


def basis(knot_m: float, splines: int, x: Float) -> tuple[NDArray[np.intp], Float]:
    """The four B-splines that are not 0 at (N,) x: the (N,) index of the first, and their (N, 4) values.

    ``splines`` is the number of B-splines on knots ``knot_m`` apart; x lies between 0 and the fourth last knot. The
    method is the recurrence of de Boor and Cox (de Boor 1978), as in scipy's ``BSpline.design_matrix``. Importing
    scipy takes half a second.
    """
    knots = knot_m * np.arange(-DEGREE, splines + 1)
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, DEGREE, splines - 1)
    values = [np.ones(len(x))]
    for degree in range(1, DEGREE + 1):
        raised = [np.zeros(len(x)) for _ in range(degree + 1)]
        for k, value in enumerate(values, start=1):
            before, after = knots[left + k - degree], knots[left + k]
            share = value / (after - before)
            raised[k - 1] += share * (after - x)
            raised[k] = share * (x - before)
        values = raised
    return left - DEGREE, np.stack(values, axis=-1)
