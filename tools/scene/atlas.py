"""The textures of bodies on one atlas, each prefiltered for several distances.

The channels of a drawing are blue, green, red, and the share of a face's tint that a texel takes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float32

from .ground_texture import pink_noise

Patch = tuple[float, float, float, float]
"""u0, du, v0, dv: texture coordinates u0 + a du, v0 + b dv of a face's point origin + a across + b up, texels."""
Texels = NDArray[np.uint8]
Colour = tuple[float, float, float]

FACADE_M: Final = (16.0, 12.8)
FACADE_TEXELS_PER_M: Final = 25
CAR_M: Final = (4.3, 1.5)
CAR_WIDTH_M: Final = 1.78
CAR_TEXELS_PER_M: Final = 100
PLAIN_TEXELS_PER_M: Final = 60
PLAIN_M: Final = 4.0
CROWN_M: Final = 4.0

CAR_PROFILE: Final = (
    (0.02, 0.32), (4.25, 0.30), (4.28, 0.62), (4.10, 0.78), (3.02, 0.94), (2.15, 1.44), (0.95, 1.46), (0.30, 1.00),
    (0.05, 0.92),
)  # fmt: skip
"""Side view of a car, (x, z) in metres from its rear end and the ground, counterclockwise from the lower rear."""
CAR_PANES: Final = (
    ((0.55, 1.0), (1.55, 0.98), (1.55, 1.37), (1.02, 1.37)),
    ((1.65, 0.98), (2.75, 0.97), (2.1, 1.36), (1.65, 1.37)),
)
WHEELS: Final = ((0.78, 0.33), (3.45, 0.33))
WHEEL_RADIUS_M: Final = 0.33


@dataclass(frozen=True)
class Drawing:
    """(H, W, 4) texels, and the (H, W) outline that cuts a face."""

    texels: Texels
    outline: NDArray[np.bool_]


def _textured(
    colour: NDArray[np.float32],
    rng: np.random.Generator,
    share: float,
    paint: int | Texels,
    outline: NDArray[np.bool_] | None = None,
) -> Drawing:
    """Return a drawing of a picture with grain of a relative strength; an outline (H, W) cuts it.

    ``paint`` is the share of the tint: one value, or (H, W) by texel.
    """
    size = colour.shape[:2]
    noise = pink_noise((size[0], size[1]), rng)[..., None] * np.float32(share)
    picture = np.clip(colour * (1 + noise), 0, 255).astype(np.uint8)
    tinted = np.dstack((picture, np.broadcast_to(np.uint8(paint), size)))
    return Drawing(tinted, np.ones(size, np.bool_) if outline is None else outline)


def _plain(rng: np.random.Generator) -> Drawing:
    side = round(PLAIN_M * PLAIN_TEXELS_PER_M)
    return _textured(np.full((side, side, 3), 200, np.float32), rng, 0.07, 255)


def _facade(
    wall: Colour, window: tuple[float, float], floor_m: float, bay_m: float, rng: np.random.Generator
) -> Drawing:
    """Return a wall with one window per bay and floor; window width and height are in metres."""
    scale = FACADE_TEXELS_PER_M
    width, height = (round(m * scale) for m in FACADE_M)
    picture = np.empty((height, width, 3), np.float32)
    picture[:] = wall
    for top in np.arange(0, FACADE_M[1] - 0.5, floor_m):
        cv2.rectangle(picture, (0, int(top * scale)), (width, int(top * scale) + 5), _scaled(wall, 1.18), -1)
        for left in np.arange(0, FACADE_M[0] - 0.5, bay_m):
            corner = (left + (bay_m - window[0]) / 2, top + (floor_m - window[1]) / 2)
            _window(picture, corner, window, scale, wall, rng)
    return _textured(picture, rng, 0.11, 90)


def _window(
    picture: Float32,
    corner: tuple[float, float],
    size: tuple[float, float],
    scale: int,
    wall: Colour,
    rng: np.random.Generator,
) -> None:
    (left, top), (width, height) = corner, size
    x0, y0, x1, y1 = (round(m * scale) for m in (left, top, left + width, top + height))
    glass = rng.uniform(0.6, 1.5) * np.array((84.0, 74.0, 62.0))
    cv2.rectangle(picture, (x0 - 3, y0 - 3), (x1 + 3, y1 + 4), _scaled(wall, 1.3), -1)
    cv2.rectangle(picture, (x0, y0), (x1, y1), tuple(float(c) for c in glass), -1)
    drop = round((y1 - y0) * rng.uniform(0, 0.7))
    cv2.rectangle(picture, (x0, y0), (x1, y0 + drop), tuple(float(c) for c in glass * 1.5), -1)
    middle = (x0 + x1) // 2
    cv2.line(picture, (middle, y0), (middle, y1), _scaled(wall, 0.8), 2)


def _scaled(colour: Colour, factor: float) -> Colour:
    b, g, r = (min(c * factor, 255.0) for c in colour)
    return b, g, r


def _car_points(points: tuple[tuple[float, float], ...]) -> NDArray[np.int32]:
    """Return fixed-point pixels of side view points, with 4 fractional bits."""
    x, z = np.array(points).T
    pixels = np.column_stack((x, CAR_M[1] - z)) * CAR_TEXELS_PER_M * 16
    return np.asarray(pixels.round(), np.int32)


def _car_side(rng: np.random.Generator) -> Drawing:
    """Return the right side of a car, front to the right; the outline is body and wheels."""
    width, height = (round(m * CAR_TEXELS_PER_M) for m in CAR_M)
    picture = np.full((height, width, 3), 205, np.float32)
    paint = np.full((height, width), 255, np.uint8)
    outline = np.zeros((height, width), np.uint8)
    cv2.fillPoly(outline, [_car_points(CAR_PROFILE)], 1, shift=4)
    for pane in CAR_PANES:
        cv2.fillPoly(picture, [_car_points(pane)], (62, 56, 50), shift=4)
        cv2.fillPoly(paint, [_car_points(pane)], 0, shift=4)
    picture[-round(0.42 * CAR_TEXELS_PER_M) :] *= 0.55
    for x in (1.6, 2.7):
        cv2.line(picture, (round(x * 100), 55), (round(x * 100), 112), (140, 140, 140), 2)
    for x, z in WHEELS:
        centre = (round(x * CAR_TEXELS_PER_M), round((CAR_M[1] - z) * CAR_TEXELS_PER_M))
        for radius, colour in ((WHEEL_RADIUS_M + 0.06, 18), (WHEEL_RADIUS_M - 0.03, 38), (0.19, 120), (0.06, 60)):
            cv2.circle(picture, centre, round(radius * CAR_TEXELS_PER_M), (colour,) * 3, -1)
        cv2.circle(paint, centre, round((WHEEL_RADIUS_M + 0.06) * CAR_TEXELS_PER_M), 0, -1)
        cv2.circle(outline, centre, round(WHEEL_RADIUS_M * CAR_TEXELS_PER_M) - 1, 1, -1)
    return _textured(picture, rng, 0.06, paint, outline > 0)


def _car_end(lamps: Colour, grille: Colour, rng: np.random.Generator) -> Drawing:
    """Return the front or rear of a car below the windows, 0.6 m high."""
    width, height = round(CAR_WIDTH_M * CAR_TEXELS_PER_M), 60
    picture = np.full((height, width, 3), 195, np.float32)
    paint = np.full((height, width), 255, np.uint8)
    parts = (
        ((8, 8), (42, 22), lamps),
        ((width - 42, 8), (width - 8, 22), lamps),
        ((55, 12), (width - 55, 26), grille),
        ((0, 42), (width, 59), (48.0, 48.0, 48.0)),
        ((64, 30), (width - 64, 40), (205.0, 208.0, 210.0)),
    )
    for low, high, colour in parts:
        cv2.rectangle(picture, low, high, colour, -1)
        cv2.rectangle(paint, low, high, 0, -1)
    return _textured(picture, rng, 0.06, paint)


def _glass(rng: np.random.Generator) -> Drawing:
    picture = np.full((50, 150, 3), (70, 62, 55), np.float32)
    picture[6:-6, 8:-8] *= 0.8
    return _textured(picture, rng, 0.12, 0)


def _crown(rng: np.random.Generator) -> Drawing:
    """Return leaves: dark and light clumps in an irregular round outline."""
    side = round(CROWN_M * 50)
    y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    clumps = cv2.GaussianBlur(rng.standard_normal((side, side)).astype(np.float32), (0, 0), 9)
    clumps = clumps / np.float32(clumps.std())
    outline = np.hypot(x, y) < 0.84 + 0.09 * clumps
    picture = np.full((side, side, 3), (52, 92, 66), np.float32) * (1 + 0.16 * clumps[..., None])
    return _textured(picture, rng, 0.3, 120, outline)


DRAWINGS: Final[tuple[tuple[str, Callable[[np.random.Generator], Drawing]], ...]] = (
    ("plain", _plain),
    ("facade0", partial(_facade, (118.0, 132.0, 142.0), (1.1, 1.7), 3.2, 2.6)),
    ("facade1", partial(_facade, (66.0, 74.0, 122.0), (0.9, 1.6), 3.2, 2.2)),
    ("facade2", partial(_facade, (150.0, 158.0, 162.0), (1.8, 1.5), 3.2, 3.2)),
    ("facade3", partial(_facade, (104.0, 120.0, 110.0), (1.0, 1.9), 3.2, 2.0)),
    ("facade4", partial(_facade, (92.0, 88.0, 86.0), (2.2, 1.8), 3.2, 3.0)),
    ("car_side", _car_side),
    ("car_tail", partial(_car_end, (40.0, 30.0, 190.0), (120.0, 120.0, 120.0))),
    ("car_nose", partial(_car_end, (235.0, 238.0, 240.0), (35.0, 35.0, 35.0))),
    ("glass", _glass),
    ("crown", _crown),
)


LEVELS: Final = 7
GUARD: Final = 2


@dataclass(frozen=True)
class Atlas:
    """Drawings side by side; below each its copies, blurred by about 2^k texels across and 2^(k/2) down."""

    texels: NDArray[np.uint8]
    """(LEVELS * stride, width, 4) blue, green, red, and the share of the tint."""
    outline: NDArray[np.bool_]
    """(stride, width) visible texels of cut faces."""
    stride: int
    corners: dict[str, tuple[int, int, int, int]]
    """u, v, width and height of each drawing at level 0."""

    def patch(self, name: str, size: tuple[float, float] = (1.0, 1.0)) -> Patch:
        """Return the patch of a drawing; ``size`` gives the used shares of its width and height from the top left."""
        u, v, width, height = self.corners[name]
        w, h = (width - 1) * min(size[0], 1.0), (height - 1) * min(size[1], 1.0)
        return u, w, v + h, -h

    def sample(self, u: Float32, v: Float32, level: NDArray[np.int32]) -> NDArray[np.uint8]:
        """Return (1, N, 4) texels at (N,) coordinates and levels."""
        rows = v + (level * self.stride).astype(np.float32)
        columns = 4096
        count = -(-len(u) // columns) * columns
        maps = [np.resize(m, count).reshape(-1, columns) for m in (u, rows)]
        picked = cv2.remap(self.texels, maps[0], maps[1], cv2.INTER_LINEAR)
        return np.asarray(picked, np.uint8).reshape(1, -1, 4)[:, : len(u)]


@cache
def load_atlas() -> Atlas:
    """Return the atlas of all drawings, the same for every seed."""
    drawn: dict[str, Drawing] = {name: draw(np.random.default_rng((i, 7))) for i, (name, draw) in enumerate(DRAWINGS)}
    stride = max(d.texels.shape[0] for d in drawn.values()) + 2 * GUARD
    width = sum(d.texels.shape[1] + 2 * GUARD for d in drawn.values())
    texels = np.zeros((LEVELS * stride, width, 4), np.uint8)
    outline = np.zeros((stride, width), np.bool_)
    corners = {}
    left = 0
    for name, drawing in drawn.items():
        height, own = drawing.texels.shape[:2]
        for level in range(LEVELS):
            copy = cv2.copyMakeBorder(_blurred(drawing.texels, level), *(GUARD,) * 4, cv2.BORDER_REPLICATE)
            texels[level * stride :][: height + 2 * GUARD, left : left + own + 2 * GUARD] = copy
        outline[GUARD : GUARD + height, left + GUARD : left + GUARD + own] = drawing.outline
        corners[name] = (left + GUARD, GUARD, own, height)
        left += own + 2 * GUARD
    return Atlas(texels, outline, stride, corners)


def _blurred(texels: NDArray[np.uint8], level: int) -> NDArray[np.uint8]:
    if level == 0:
        return texels
    blurred = cv2.GaussianBlur(
        texels, (0, 0), sigmaX=0.5 * 2**level, sigmaY=0.5 * 2 ** (level / 2), borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(blurred, np.uint8)
