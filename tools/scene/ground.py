"""Where each pixel's ray meets the ground: road, raised sidewalks and the curbs between them, exactly, and its paint.

The ground is two layers of the terrain, the road and, a curb's height above it, everything beyond the curbs. A ray that
passes the upper layer over the road and would meet the lower one beyond the curb has met the curb's upright face.
"""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32

from .grain import pink_noise
from .lanes import CURB_HEIGHT_M, DASH_M, DASH_PERIOD_M, LINE_M, Colour, Marking, Markings, line_gap
from .options import Stretch
from .path import LocalPath, Real
from .roads import LocalCrossing
from .world import World

FAR_M: Final = 1000.0
"""CARLA's far plane: what lies beyond is sky."""
FALSI_STEPS: Final = 8


@dataclass(frozen=True)
class Ground:
    """The image's rows from ``top_row`` on; all arrays (rows, W). Where ``depth_m`` is FAR_M there is no ground."""

    top_row: int
    depth_m: Float32
    s_m: Float32
    """Along the road, counted from ``road.s_origin_m``."""
    d_m: Float32
    """Across the road, as the cross-section has it."""
    across_m: Float32
    """Across the road, where it is; the same array where the road is no wider than the cross-section says."""
    x_m: Float32
    """World x and y, counted from ``road.origin_m``."""
    y_m: Float32
    curb: NDArray[np.bool_]
    """Where a curb's upright face is seen."""
    line_gap: NDArray[np.bool_]
    """Where the ego lane's right line, if it were there, is interrupted."""
    road: LocalPath | LocalCrossing


@dataclass(frozen=True)
class _Rays:
    """World directions of pixels per metre of depth, arrays of any one shape."""

    centre_m: Float
    dx: Float
    dy: Float
    dz: Float


def trace_ground(camera: Camera, world_T_camera: Float, world: World, s_m: float) -> Ground:
    """The ground as the camera sees it; ``s_m`` is where along the road the camera is."""
    road = world.ground_path.around(s_m)
    top_row, rays = _rays(camera, world_T_camera, world.terrain.steepest)
    depth = np.minimum(world.terrain.first_hits(rays.centre_m, rays.dx, rays.dz, 0.0), FAR_M)
    start = rays.centre_m[:2] - road.origin_m
    x, y = _at(start, rays, depth)
    s, across, d = _places(road, world, x, y)
    gap = line_gap(s, road.s_origin_m) if world.section.broken else np.zeros(s.shape, np.bool_)
    ground = Ground(top_row, depth.astype(np.float32), s, d, across, x, y, np.zeros(depth.shape, np.bool_), gap, road)
    _raise_beyond_curbs(ground, depth, rays, start, world)
    return ground


def _rays(camera: Camera, world_T_camera: Float, steepest: float) -> tuple[int, _Rays]:
    """Directions of all pixels from the first row on that can see ground."""
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


def _raise_beyond_curbs(ground: Ground, depth_m: Float, rays: _Rays, start: Float, world: World) -> None:
    """Replaces what lies beyond the curbs by the raised layer and the curbs' faces, in place."""
    curb_m = world.section.curb_m
    # A ray sinks by a curb's height within about an eighth of its depth: only so near a curb can the layers matter.
    chosen = np.flatnonzero(np.abs(ground.d_m) > curb_m - 0.3 - 0.12 * ground.depth_m)
    picked = _Rays(rays.centre_m, *(a.ravel()[chosen] for a in (rays.dx, rays.dy, rays.dz)))
    upper = np.minimum(world.terrain.first_hits(rays.centre_m, picked.dx, picked.dz, CURB_HEIGHT_M), FAR_M)
    x, y = _at(start, picked, upper)
    s, across, d = _places(ground.road, world, x, y)
    raised = (np.abs(d) >= curb_m) & (upper < FAR_M)
    # A rounding off the border, or the table of tags would call the curb's very edge road.
    d = np.copysign(np.maximum(np.abs(d), np.float32(curb_m + 1e-4)), d)
    _put(ground, chosen[raised], *(a[raised] for a in (upper.astype(np.float32), s, across, d, x, y)))
    lower = depth_m.ravel()[chosen]
    faced = ~raised & (np.abs(ground.d_m.ravel()[chosen]) >= curb_m) & (lower < FAR_M)
    picked = _Rays(rays.centre_m, *(a[faced] for a in (picked.dx, picked.dy, picked.dz)))
    depth = _curb_depth(ground.road, start, picked, upper[faced], lower[faced], world)
    x, y = _at(start, picked, depth)
    s, across, d = _places(ground.road, world, x, y)
    _put(ground, chosen[faced], depth.astype(np.float32), s, across, np.copysign(np.float32(curb_m + 0.01), d), x, y)
    ground.curb.ravel()[chosen[faced]] = True


def _put(ground: Ground, where: NDArray[np.intp], *values: Float32) -> None:
    targets = (ground.depth_m, ground.s_m, ground.across_m, ground.d_m, ground.x_m, ground.y_m)
    for target, value in zip(targets, values, strict=True):
        target.ravel()[where] = value


def _places(road: LocalPath | LocalCrossing, world: World, x_m: Real, y_m: Real) -> tuple[Real, Real, Real]:
    """S, and d both as it is and as the cross-section has it, of local points."""
    s, across = road.coordinates(x_m, y_m)
    return s, across, world.road.section_d(s + road.s_origin_m, across)


def _curb_depth(
    road: LocalPath | LocalCrossing, start: Float, rays: _Rays, near_m: Float, far_m: Float, world: World
) -> Float:
    """Depth between two bounds at which rays cross the curbs, by regula falsi (Illinois)."""

    def beyond(depth_m: Float) -> Float:
        _, _, d = _places(road, world, start[0] + depth_m * rays.dx, start[1] + depth_m * rays.dy)
        excess: Float = np.abs(d) - world.section.curb_m
        return excess

    low, high = near_m, far_m
    f_low, f_high = beyond(low), beyond(high)
    middle = low
    for _ in range(FALSI_STEPS):
        with np.errstate(invalid="ignore", divide="ignore"):
            middle = np.where(f_high != f_low, (low * f_high - high * f_low) / (f_high - f_low), low)
        f_middle = beyond(middle)
        past = f_middle >= 0
        f_low, f_high = np.where(past, f_low / 2, f_middle), np.where(past, f_middle, f_high / 2)
        low, high = np.where(past, low, middle), np.where(past, middle, high)
    return middle


PAINT_CONTRAST: Final = 0.3
"""Relative strength of the paint's grain, as the sections have it."""

REMAINING: Final = 0.35
"""Share of worn paint that is still there."""
FADED: Final = 0.6
"""How much of its colour that has left."""
WEAR_TEXEL_M: Final = 0.04


@dataclass(frozen=True)
class Paint:
    """What of the ground's rows is painted.

    ``line`` are the pixels of the class, exactly; ``layers`` are colours with the share (rows, W) of each pixel that
    they cover, softly at the borders.
    """

    line: NDArray[np.bool_]
    layers: tuple[tuple[Colour, Float32], ...]


def paint_on(markings: Markings, ground: Ground, focal_px: float) -> Paint:
    """The paint that a camera sees."""
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
    """Where worn paint is still there."""
    pattern = _wear_pattern()
    rows = np.floor(s_m / WEAR_TEXEL_M).astype(np.intp) % pattern.shape[0]
    columns = np.floor(across_m / WEAR_TEXEL_M).astype(np.intp) % pattern.shape[1]
    remains: NDArray[np.bool_] = pattern[rows, columns]
    return remains


@cache
def _wear_pattern() -> NDArray[np.bool_]:
    """Patches of every size; it repeats every 20 m along the road and every 5 m across it."""
    noise = pink_noise((512, 128), np.random.default_rng(17))
    return noise > np.quantile(noise, 1 - REMAINING)


def _painted(
    marking: Marking, ground: Ground, s_m: NDArray[np.float64], focal_px: float
) -> tuple[NDArray[np.bool_], Float32]:
    """(rows, W) whether a pixel is on the line, and the share of it that is."""
    there = (s_m >= marking.from_m) & (s_m < marking.to_m)
    if marking.dashes == "all":
        there &= s_m % DASH_PERIOD_M < DASH_M
    elif marking.dashes == "stretches":
        there &= ~line_gap(s_m.astype(np.float32), 0.0)
    inward = LINE_M / 2 - np.abs(ground.across_m - marking.middle_m.at(s_m))
    pixel_m = ground.depth_m / np.float32(focal_px)
    share = np.clip(inward / pixel_m + 0.5, 0, 1) * np.minimum(LINE_M / pixel_m, 1)
    return there & (inward >= 0), np.asarray(share * there, np.float32)
