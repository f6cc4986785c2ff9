"""The road as a smooth height field z(x, y) in the ego frame, for roads that climb and fall.

Method: a penalised B-spline (P-spline, Eilers and Marx 1996), cubic on evenly spaced knots along x (de Boor 1978) and
linear across y, is added to the road's plane. The penalty on the second differences of its coefficients is the prior
that a road's curvature has a standard deviation, so that the data's own scatter decides how smooth the field is, and
where there are no data it goes on straight. The fit is robust by iteratively reweighted least squares (Holland and
Welsch 1977): Huber's weights find the road, Tukey's then leave out what stands on it. It grows outwards from the car,
by what a road can bend, and uses one point of each square metre, the one of median height, so that the many pixels near
the car count no more than the few far ahead. Only four B-splines are not 0 at a point, so that the equations of a long
road are solved as a band, in a time that grows with its length.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.kernels import median_places, normal_equations
from roadperc_stream.chain.stages.surface.plane import NORMAL_MAD, first_row, median
from roadperc_stream.config import SurfaceConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.geometry.ground import REACH_M, ego_points, part
from roadperc_stream.model import HeightGrid, Mask, Surface

DEGREE: Final = 3
"""Of the B-splines along x."""
_STEP_M = 1.0
"""Side of the fit's cells, and of the grid's."""
_COLUMNS = 160
"""Image columns that are used: evenly spread, as neighbours are alike. Rows are few where the road is far."""
_ENOUGH_POINTS = 20_000
"""Points of the road that are never thinned: a lidar's are hardly more."""
_SUPPORT = 2 * (DEGREE + 1)
"""Coefficients that count at a place: those of four B-splines, in the middle and across."""
_MIN_CELLS = 12
_MIN_LENGTH_KNOTS = 2
"""Stretch of road in knots below which a height field says no more than a plane."""
_BANK_STD = 0.03
"""Standard deviation of the slope across the road against the plane's, which holds where a strip is too narrow."""
_POINTS_THAT_COUNT = 4
"""Points of a cell beyond which more do not make it more certain: their errors are not independent."""
_FINEST_STD_M = 0.005
_HUBER, _TUKEY = 1.345, 4.685
"""Standard deviations; each constant keeps 95 % of the efficiency on normal errors."""
_HUBER_ROUNDS, _TUKEY_ROUNDS = 4, 3
_REACH_STEP_M = 10.0
_GATE_M, _GATE_STDS = 0.3, 3.0
"""A cell is left out that is this far from the field found so far, and from where such a curvature would take it."""


@dataclass(frozen=True)
class _Design:
    """The equations of N places: (N, 8) indices of the coefficients that count there, and by how much each counts.

    Coefficients of one B-spline are neighbours: its height in the middle, then its rise in a half width across.
    """

    indices: NDArray[np.intp]
    values: Float

    def take(self, chosen: Mask) -> "_Design":
        """The places of a mask."""
        return _Design(self.indices[chosen], self.values[chosen])

    def heights(self, coefficients: Float) -> Float:
        """(N,) metres."""
        result: Float = np.sum(self.values * coefficients[self.indices], axis=1)
        return result


def road_cells(
    cfg: SurfaceConfig, surface: Surface, camera: Camera, ego_T_camera: Float, depth_m: Float32, usable: Mask
) -> tuple[Float, Float]:
    """One point for each square metre of the road, ``spline_half_width_m`` to either side and ``max_depth_m`` ahead.

    It is the point of median height. A mean of places and a median of heights do not belong together on a slope.

    Args:
        cfg: the extent.
        surface: the road's plane.
        camera: the camera of the depth.
        ego_T_camera: its mounting.
        depth_m: (H, W) metres, NaN unknown.
        usable: (H, W) pixels of the road with known depth.

    Returns:
        (N, 3) x, y and height above the plane, metres, and (N,) certainty, 0 to 1, which grows with a cell's points.
    """
    columns = max(min(camera.width // _COLUMNS, int(np.count_nonzero(usable)) // _ENOUGH_POINTS), 1)
    top = first_row(usable)
    sampled, depth_m = usable[top:, ::columns], depth_m[top:, ::columns]
    ego = ego_points(part(camera, 1, columns), ego_T_camera, depth_m, top)
    x, y, z = (numbers[sampled] for numbers in ego)
    length_m, half_m, step_m = (np.float32(value) for value in (_length_m(cfg), cfg.spline_half_width_m, _STEP_M))
    inside = (x >= 0) & (x < length_m) & (np.abs(y) < half_m)
    x, y, z = x[inside], y[inside], z[inside]
    cells = (x / step_m).astype(np.int32) * np.int32(_cells_across(cfg)) + ((y + half_m) / step_m).astype(np.int32)
    a, b, d = np.array(surface.abd, np.float32)
    points = np.stack((x, y, z - (d - a * x - b * y)))
    # One row of cells more: y at the left edge may be rounded up to it.
    along = int(np.ceil(_length_m(cfg) / _STEP_M)) + 1
    chosen, counts = median_places(cells, points[2], along * _cells_across(cfg))
    certainty = np.minimum(counts, _POINTS_THAT_COUNT) / _POINTS_THAT_COUNT
    return np.ascontiguousarray(points[:, chosen].T, np.float64), certainty


def fit_height_grid(cfg: SurfaceConfig, surface: Surface, points: Float, certainty: Float) -> HeightGrid | None:
    """The height field through the road's cells.

    Args:
        cfg: knots, smoothness and extent.
        surface: the road's plane.
        points: (N, 3) of the cells, as ``road_cells`` gives them.
        certainty: (N,) of each.

    Returns:
        The field on a grid of 1 m, or None where too few cells ahead of the car support one.
    """
    if len(points) < _MIN_CELLS or np.ptp(points[:, 0]) < _MIN_LENGTH_KNOTS * cfg.spline_knot_m:
        return None
    return _grid(cfg, surface, _grow(cfg, points, certainty))


def _cells_across(cfg: SurfaceConfig) -> int:
    return int(np.ceil(2 * cfg.spline_half_width_m / _STEP_M))


def _length_m(cfg: SurfaceConfig) -> float:
    """Length of the field: whole knots, to the farthest point that counts at least."""
    return float(np.ceil(min(cfg.max_depth_m, REACH_M) / cfg.spline_knot_m)) * cfg.spline_knot_m


def _splines(cfg: SurfaceConfig) -> int:
    """B-splines along x."""
    return round(_length_m(cfg) / cfg.spline_knot_m) + DEGREE


def _design(cfg: SurfaceConfig, x: Float, y: Float) -> _Design:
    """The values of the B-splines at places, and the same times y in half widths."""
    first, along = basis(cfg.spline_knot_m, _splines(cfg), np.clip(x, 0.0, _length_m(cfg)))
    across = along * (y / cfg.spline_half_width_m)[:, None]
    return _Design(2 * first[:, None] + np.arange(_SUPPORT), np.stack((along, across), axis=-1).reshape(-1, _SUPPORT))


@lru_cache(maxsize=2)
def _prior(cfg: SurfaceConfig) -> Float:
    """(15, 2 M) information on the coefficients, as a band: curvature along x at middle and edges, slope across."""
    count = _splines(cfg)
    bend = np.diff(np.eye(count), 2, axis=0) / (cfg.spline_curvature_per_m * cfg.spline_knot_m**2)
    bank = np.eye(count) / (_BANK_STD * cfg.spline_half_width_m)
    prior = np.zeros((2 * count, 2 * count))
    prior[::2, ::2] = bend.T @ bend
    prior[1::2, 1::2] = bend.T @ bend + bank.T @ bank
    band = np.zeros((2 * _SUPPORT - 1, 2 * count))
    for beside in range(1 - _SUPPORT, _SUPPORT):
        diagonal = np.diag(prior, -beside)
        start = max(-beside, 0)
        band[_SUPPORT - 1 + beside, start : start + len(diagonal)] = diagonal
    return band


def _grow(cfg: SurfaceConfig, points: Float, certainty: Float) -> Float:
    """Coefficients of the field, fitted farther and farther ahead.

    What lies where a road of plausible curvature cannot go on to is left out: far ahead, where a crest hides the road,
    there is nothing else to contradict it.

    Args:
        cfg: smoothness and extent.
        points: (N, 3) x, y and height above the plane of the cells, metres.
        certainty: (N,) 0 to 1.
    """
    x, heights = points[:, 0], points[:, 2]
    design, prior = _design(cfg, x, points[:, 1]), _prior(cfg)
    coefficients: Float = np.zeros(prior.shape[1])
    known_m = float(x.min())
    for reach in np.arange(known_m + _REACH_STEP_M, _length_m(cfg) + _REACH_STEP_M, _REACH_STEP_M):
        bend = _GATE_STDS * cfg.spline_curvature_per_m / 2 * np.maximum(x - known_m, 0.0) ** 2
        inliers = (x <= reach) & (np.abs(heights - design.heights(coefficients)) <= _GATE_M + bend)
        if inliers.any():
            coefficients = _robust_fit(design.take(inliers), heights[inliers], certainty[inliers], prior, coefficients)
            known_m = float(x[inliers].max())
    return coefficients


def _robust_fit(design: _Design, heights: Float, certainty: Float, prior: Float, coefficients: Float) -> Float:
    """(P,) coefficients by penalised least squares with weights that follow the residuals.

    Args:
        design: of N places.
        heights: (N,) metres.
        certainty: (N,) 0 to 1.
        prior: (15, P) information, a band.
        coefficients: (P,) to start from.
    """
    count = prior.shape[1]
    first = design.indices[:, 0]
    for i in range(_HUBER_ROUNDS + _TUKEY_ROUNDS):
        residual = np.abs(heights - design.heights(coefficients))
        std = max(NORMAL_MAD * median(residual), _FINEST_STD_M)
        off = residual / std
        if i < _HUBER_ROUNDS:  # beyond the constant residuals pull no harder
            robust = np.minimum(1.0, _HUBER / np.maximum(off, _HUBER))
        else:  # beyond it they do not pull at all
            robust = np.clip(1.0 - (off / _TUKEY) ** 2, 0.0, None) ** 2
        weights = robust * certainty / std**2
        lower, right = normal_equations(first, design.values, weights, heights, count)
        coefficients = solved(band_of(lower) + prior, right, coefficients)
    return coefficients


def _grid(cfg: SurfaceConfig, surface: Surface, coefficients: Float) -> HeightGrid:
    """Plane and field together at the grid's nodes."""
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


def band_of(lower: Float) -> Float:
    """(2 D - 1, P) band of a symmetric (P, P) matrix from the (D, P) diagonals in and below its middle.

    Row r holds the elements of the diagonal r - D + 1 below the middle, each at its column.
    """
    diagonals, columns = lower.shape
    band = np.zeros((2 * diagonals - 1, columns))
    band[diagonals - 1 :] = lower
    for beside in range(1, diagonals):
        band[diagonals - 1 - beside, beside:] = lower[beside, :-beside]
    return band


def solved(band: Float, right: Float, otherwise: Float) -> Float:
    """(P,) solution of equations given as a (2 D - 1, P) band, by LU decomposition; ``otherwise`` where there is none.

    LAPACK itself: what scipy's ``solve_banded`` does before it calls the same function takes longer than all the rest.
    """
    from scipy.linalg.lapack import dgbsv

    beside = len(band) // 2
    workspace = np.zeros((len(band) + beside, band.shape[1]), order="F")
    workspace[beside:] = band
    _, _, solution, fault = dgbsv(beside, beside, workspace, right, overwrite_ab=True)
    return otherwise if fault else np.asarray(solution, float)


def basis(knot_m: float, splines: int, x: Float) -> tuple[NDArray[np.intp], Float]:
    """The four B-splines that are not 0 at a place: the (N,) index of the first, and their (N, 4) values.

    By the recurrence of de Boor and Cox from degree 0 on (de Boor 1978), as scipy's ``BSpline.design_matrix`` has it,
    whose import takes half a second.

    Args:
        knot_m: distance of the knots.
        splines: how many there are.
        x: (N,) from 0 to the last knot but three.
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
