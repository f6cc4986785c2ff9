"""Exact intersections of pixel rays with the ground (road, raised sidewalks, curbs), and the paint on it.

The ground has two layers: the road, and the area beyond the curbs one curb height above it. A ray meets the upright
face of a curb if it passes the upper layer over the road and the lower layer beyond the curb.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32

from .ground_texture import pink_noise
from .lanes import CURB_HEIGHT_M, DASH_M, DASH_PERIOD_M, LINE_M, Colour, Marking, Markings, line_gap
from .options import Stretch
from .path import LocalPath, Real
from .roads import LocalCrossing
from .scenes import RenderedScene

FAR_M: Final = 1000.0
"""CARLA's far plane; everything beyond it is sky."""
FALSI_STEPS: Final = 8


@dataclass(frozen=True)
class Ground:
    """The ground in the image rows from ``top_row`` on: arrays (rows, W); ``depth_m`` is FAR_M without ground."""

    top_row: int
    depth_m: Float32
    s_m: Float32
    """Position along the road relative to ``road.s_origin_m``."""
    d_m: Float32
    """Position across the road in the coordinates of the cross-section."""
    across_m: Float32
    """True position across the road; the same array as ``d_m`` if the road is not widened."""
    x_m: Float32
    """World x relative to ``road.origin_m``; ``y_m`` likewise."""
    y_m: Float32
    curb: NDArray[np.bool_]
    """True on the upright face of a curb."""
    line_gap: NDArray[np.bool_]
    """True in the gaps of a broken right line of the ego lane."""
    road: LocalPath | LocalCrossing


@dataclass(frozen=True)
class _Rays:
    """World directions of pixels per metre of depth; the arrays have one common shape."""

    centre_m: Float
    dx: Float
    dy: Float
    dz: Float


def trace_ground(camera: Camera, world_T_camera: Float, scene: RenderedScene, s_m: float) -> Ground:
    """Return the ground in the camera's image; ``s_m`` is the camera's position along the road."""
    road = scene.ground_path.around(s_m)
    top_row, rays = _rays(camera, world_T_camera, scene.terrain.steepest)
    depth = np.minimum(scene.terrain.first_hits(rays.centre_m, rays.dx, rays.dz, 0.0), FAR_M)
    start = rays.centre_m[:2] - road.origin_m
    x, y = _at(start, rays, depth)
    s, across, d = _places(road, scene, x, y)
    gap = line_gap(s, road.s_origin_m) if scene.section.broken else np.zeros(s.shape, np.bool_)
    ground = Ground(top_row, depth.astype(np.float32), s, d, across, x, y, np.zeros(depth.shape, np.bool_), gap, road)
    _raise_beyond_curbs(ground, depth, rays, start, scene)
    return ground


def _rays(camera: Camera, world_T_camera: Float, steepest: float) -> tuple[int, _Rays]:
    """Return the first row that can show ground, and the directions of all pixels from that row on."""
    R = world_T_camera[:3, :3]
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    ends = u[[0, -1]]
    lowest = (R[2, 0] * ends + R[2, 2] + R[2, 1] * v[:, None]) - steepest * np.abs(
        R[0, 0] * ends + R[0, 2] + R[0, 1] * v[:, None]
    )
    rows = np.flatnonzero((lowest < 0).any(axis=1))
    top_row = int(rows[0]) if len(rows) else camera.height - 1
    dx, dy, dz = ((R[i, 0] * u + R[i, 2]) + (R[i, 1] * v[top_row:])[:, None] for i in range(3))
    return top_row, _Rays(world_T_camera[:3, 3], dx, dy, dz)


def _at(start: Float, rays: _Rays, depth_m: Float) -> tuple[Float32, Float32]:
    x = depth_m * rays.dx
    x += start[0]
    y = depth_m * rays.dy
    y += start[1]
    return x.astype(np.float32), y.astype(np.float32)


def _raise_beyond_curbs(ground: Ground, depth_m: Float, rays: _Rays, start: Float, scene: RenderedScene) -> None:
    """Replace the ground beyond the curbs by the raised layer and the faces of the curbs, in place."""
    curb_m = scene.section.curb_m
    # A ray descends by a curb's height within about an eighth of its depth. Other pixels cannot change layers.
    chosen = np.flatnonzero(np.abs(ground.d_m) > curb_m - 0.3 - 0.12 * ground.depth_m)
    picked = _Rays(rays.centre_m, *(a.ravel()[chosen] for a in (rays.dx, rays.dy, rays.dz)))
    upper = np.minimum(scene.terrain.first_hits(rays.centre_m, picked.dx, picked.dz, CURB_HEIGHT_M), FAR_M)
    x, y = _at(start, picked, upper)
    s, across, d = _places(ground.road, scene, x, y)
    raised = (np.abs(d) >= curb_m) & (upper < FAR_M)
    # Stay off the border by more than a rounding error, or the tag table gives road at the edge of the curb.
    d = np.copysign(np.maximum(np.abs(d), np.float32(curb_m + 1e-4)), d)
    _put(ground, chosen[raised], *(a[raised] for a in (upper.astype(np.float32), s, across, d, x, y)))
    lower = depth_m.ravel()[chosen]
    faced = ~raised & (np.abs(ground.d_m.ravel()[chosen]) >= curb_m) & (lower < FAR_M)
    picked = _Rays(rays.centre_m, *(a[faced] for a in (picked.dx, picked.dy, picked.dz)))
    depth = _curb_depth(ground.road, start, picked, upper[faced], lower[faced], scene)
    x, y = _at(start, picked, depth)
    s, across, d = _places(ground.road, scene, x, y)
    _put(ground, chosen[faced], depth.astype(np.float32), s, across, np.copysign(np.float32(curb_m + 0.01), d), x, y)
    ground.curb.ravel()[chosen[faced]] = True


def _put(ground: Ground, where: NDArray[np.intp], *values: Float32) -> None:
    targets = (ground.depth_m, ground.s_m, ground.across_m, ground.d_m, ground.x_m, ground.y_m)
    for target, value in zip(targets, values, strict=True):
        target.ravel()[where] = value


def _places(road: LocalPath | LocalCrossing, scene: RenderedScene, x_m: Real, y_m: Real) -> tuple[Real, Real, Real]:
    """Return s, the true d and the cross-section's d of local points."""
    s, across = road.coordinates(x_m, y_m)
    return s, across, scene.road.section_d(s + road.s_origin_m, across)


def _curb_depth(
    road: LocalPath | LocalCrossing, start: Float, rays: _Rays, near_m: Float, far_m: Float, scene: RenderedScene
) -> Float:
    """Return the depth between two bounds where rays cross the curbs, by regula falsi (Illinois)."""

    def beyond(depth_m: Float) -> Float:
        _, _, d = _places(road, scene, start[0] + depth_m * rays.dx, start[1] + depth_m * rays.dy)
        return np.asarray(np.abs(d) - scene.section.curb_m)

    low, high, middle = near_m, far_m, near_m
    f_low, f_high = beyond(low), beyond(high)
    for _ in range(FALSI_STEPS):
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = np.where(f_high != f_low, (low * f_high - high * f_low) / (f_high - f_low), low)
        f_middle = beyond(middle)
        past = f_middle >= 0
        f_low, f_high = np.where(past, f_low / 2, f_middle), np.where(past, f_middle, f_high / 2)
        low, high = np.where(past, low, middle), np.where(past, middle, high)
    return middle


PAINT_CONTRAST: Final = 0.3
"""Relative strength of the paint's grain, as in the cross-sections."""

REMAINING: Final = 0.35
"""Share of worn paint that remains."""
FADED: Final = 0.6
"""Opacity of the remaining paint."""
WEAR_TEXEL_M: Final = 0.04


@dataclass(frozen=True)
class Paint:
    """The paint on the rows of a ``Ground``.

    ``line`` (rows, W) marks the pixels of the class. ``layers`` holds colours with the share (rows, W) that they cover
    of each pixel; the borders are soft.
    """

    line: NDArray[np.bool_]
    layers: tuple[tuple[Colour, Float32], ...]


def paint_on(markings: Markings, ground: Ground, focal_px: float) -> Paint:
    """Return the paint in the camera's image."""
    s = ground.s_m + np.float64(ground.road.s_origin_m)
    on_road = (ground.depth_m < FAR_M) & ~ground.curb & ~_within(s, markings.missing)
    fresh: Float32 = np.ones(s.shape, np.float32)
    if markings.worn:
        worn = _within(s, markings.worn)
        on_road &= ~worn | _remains(s, ground.across_m)
        fresh = np.where(worn, np.float32(FADED), fresh)
    line = np.zeros(s.shape, np.bool_)
    layers: dict[Colour, Float32] = {}
    for marking in markings.lines:
        inside, cover = _painted(marking, ground, s, focal_px)
        line |= inside & on_road
        before = layers.get(marking.colour, np.float32(0))
        layers[marking.colour] = np.maximum(before, cover * on_road * fresh).astype(np.float32)
    return Paint(line, tuple(layers.items()))


def _within(s_m: NDArray[np.float64], stretches: tuple[Stretch, ...]) -> NDArray[np.bool_]:
    inside = np.zeros(s_m.shape, np.bool_)
    for start, end in stretches:
        inside |= (s_m >= start) & (s_m < end)
    return inside


def _remains(s_m: NDArray[np.float64], across_m: Float32) -> NDArray[np.bool_]:
    """Return True where worn paint remains."""
    pattern = _wear_pattern()
    rows = np.floor(s_m / WEAR_TEXEL_M).astype(np.intp) % pattern.shape[0]
    columns = np.floor(across_m / WEAR_TEXEL_M).astype(np.intp) % pattern.shape[1]
    return np.asarray(pattern[rows, columns])


@cache
def _wear_pattern() -> NDArray[np.bool_]:
    """Return patches of every size; the pattern repeats every 20 m along the road and every 5 m across."""
    noise = pink_noise((512, 128), np.random.default_rng(17))
    return noise > np.quantile(noise, 1 - REMAINING)


def _painted(
    marking: Marking, ground: Ground, s_m: NDArray[np.float64], focal_px: float
) -> tuple[NDArray[np.bool_], Float32]:
    """Return two arrays (rows, W): True if a pixel is on the line, and the share of the pixel on it."""
    there = (s_m >= marking.from_m) & (s_m < marking.to_m)
    if marking.dashes == "all":
        there &= s_m % DASH_PERIOD_M < DASH_M
    elif marking.dashes == "stretches":
        there &= ~line_gap(s_m.astype(np.float32), 0.0)
    inward = LINE_M / 2 - np.abs(ground.across_m - marking.middle_m.at(s_m))
    pixel_m = ground.depth_m / np.float32(focal_px)
    share = np.clip(inward / pixel_m + 0.5, 0, 1) * np.minimum(LINE_M / pixel_m, 1)
    return there & (inward >= 0), np.asarray(share * there, np.float32)
