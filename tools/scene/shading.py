"""Colours of sky, ground and faces in daylight with haze."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Camera, Float, Float32, inverse, transform

from .atlas import LEVELS as ATLAS_LEVELS
from .atlas import Atlas
from .ground import PAINT_CONTRAST, Ground, Paint
from .ground_texture import LEVELS as TEXTURE_LEVELS
from .ground_texture import ROWS, TEXEL_M, TEXTURE_STD, GroundTexture, depth_level, level_depth_m, pink_noise
from .lanes import REACH_M, RoadSection, Zone
from .raster import Drawn, pixel_boxes

Picture = NDArray[np.uint8]

HAZE: Final = np.array((222.0, 210.0, 200.0), np.float32)
HAZE_M: Final = 900.0
SUN: Final = np.array((0.35, 0.5, 0.79))
"""Unit vector towards the sun, world frame."""
AMBIENT: Final = 0.55
CURB_LIGHT: Final = 0.55
PROFILE_TEXEL_M: Final = 0.01
SHADOW_RIM_M: Final = 0.35
SHADOW_DEPTH: Final = 0.62
SHADOW_MARGIN_PX: Final = 3
TEXTURE_PERIOD_M: Final = TEXEL_M * ROWS
TEXTURE_SHARE: Final = 0.16
"""Relative standard deviation of grain at contrast 1."""


@dataclass(frozen=True)
class Shadow:
    """A soft dark area on the ground below a body, of the size of its outline."""

    world_T_body: Float
    half_length_m: float
    half_width_m: float

    def corners(self) -> Float:
        """Return (4, 3) world points around the shadow and its soft rim."""
        x, y = self.half_length_m + SHADOW_RIM_M, self.half_width_m + SHADOW_RIM_M
        return transform(self.world_T_body, np.array([(x, y, 0.0), (-x, y, 0.0), (-x, -y, 0.0), (x, -y, 0.0)]))


@lru_cache(maxsize=4)
def ground_profile(section: RoadSection, focal_px: float) -> Float32:
    """Return the cross-section's colours in haze and the strength of their grain over d, one row per depth level.

    Each row is blurred by the width of a pixel at its depth. The second half of the rows has no right line, for the
    gaps of a broken line.
    """
    lineless = tuple(zone for zone in section.zones if zone.high_m != section.right_edge_m)
    rows = [
        _seen_from(_painted(zones), level_depth_m(level), focal_px)
        for zones in (section.zones, lineless)
        for level in range(TEXTURE_LEVELS)
    ]
    return np.concatenate(rows)


def _painted(zones: Sequence[Zone]) -> Float32:
    """Return (1, N, 4) colour and contrast by d."""
    d = -REACH_M + PROFILE_TEXEL_M * (np.arange(round(2 * REACH_M / PROFILE_TEXEL_M)) + 0.5)
    row = np.zeros((1, len(d), 4), np.float32)
    for zone in zones:
        row[0, (d >= zone.low_m) & (d < zone.high_m)] = (*zone.colour, zone.contrast)
    return row


def _seen_from(row: Float32, depth_m: float, focal_px: float) -> Float32:
    sigma = max(depth_m / focal_px / PROFILE_TEXEL_M / 2, 0.3)
    row = np.asarray(cv2.GaussianBlur(row, (2 * int(3 * sigma + 1) + 1, 1), sigmaX=sigma, sigmaY=0.1), np.float32)
    clear = float(np.exp(-depth_m / HAZE_M))
    row[..., :3] = HAZE + (row[..., :3] - HAZE) * clear
    row[..., 3] *= TEXTURE_SHARE * clear
    return row


def ground_colours(
    ground: Ground, section: RoadSection, texture: GroundTexture, brightness: Float32, paint: Paint | None
) -> Picture:
    """Return (rows, W, 3) colours of the ground at a brightness (rows, W); undefined where there is no ground."""
    level = depth_level(ground.depth_m)
    column = (ground.d_m + np.float32(REACH_M)) * np.float32(1 / PROFILE_TEXEL_M) - np.float32(0.5)
    row = level
    if section.broken:
        row = np.where(ground.line_gap, np.rint(level) + np.float32(TEXTURE_LEVELS), level)
    base = cv2.remap(
        ground_profile(section, texture.focal_px), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    s = ground.s_m + np.float32(ground.road.s_origin_m % TEXTURE_PERIOD_M)
    if paint is not None:
        base = _with_paint(base, paint, ground.depth_m)
    noise = texture.sample(s, ground.across_m, level, np.abs(ground.d_m) >= section.curb_m)
    *colours, contrast = cv2.split(base)
    gain = noise.astype(np.float32)
    gain -= 128
    gain *= contrast
    gain *= np.float32(1 / TEXTURE_STD)
    gain += 1
    gain *= brightness
    gain[ground.curb] *= np.float32(CURB_LIGHT)
    return np.asarray(cv2.convertScaleAbs(cv2.merge([colour * gain for colour in colours])), np.uint8)


def _with_paint(base: NDArray[Any], paint: Paint, depth_m: Float32) -> Float32:
    """Return (rows, W, 4) colours in haze and grain strength, covered by the paint."""
    clear = np.exp(-depth_m / np.float32(HAZE_M))[..., None]
    for colour, cover in paint.layers:
        veiled = HAZE + (np.array(colour, np.float32) - HAZE) * clear
        coat = np.concatenate((veiled, clear * np.float32(PAINT_CONTRAST * TEXTURE_SHARE)), axis=-1)
        base = base + (coat - base) * cover[..., None]
    return np.asarray(base, np.float32)


def cast_shadows(
    brightness: Float32, ground: Ground, shadows: Sequence[Shadow], camera: Camera, world_T_camera: Float
) -> None:
    """Darken the ground's brightness (rows, W) in shadows with soft rims, in place."""
    if not shadows:
        return
    corners = transform(inverse(world_T_camera), np.stack([shadow.corners() for shadow in shadows]))
    # Add a margin: where the slope changes, the shadow is not in the plane of the wheels.
    margin = SHADOW_MARGIN_PX
    for (x0, y0, x1, y1), shadow in zip(pixel_boxes(camera, corners), shadows, strict=True):
        if x1 > x0 and y1 > ground.top_row:
            rows = slice(max(y0 - ground.top_row - margin, 0), y1 - ground.top_row + margin)
            _cast_shadow(brightness, ground, shadow, (rows, slice(max(x0 - margin, 0), x1 + margin)))


def _cast_shadow(brightness: Float32, ground: Ground, shadow: Shadow, box: tuple[slice, slice]) -> None:
    body_T_world = inverse(shadow.world_T_body)
    offset = transform(body_T_world, np.array([*ground.road.origin_m, shadow.world_T_body[2, 3]]))
    (xx, xy), (yx, yy) = body_T_world[:2, :2].astype(np.float32)
    world_x, world_y = ground.x_m[box], ground.y_m[box]
    out_x = np.abs(xx * world_x + xy * world_y + np.float32(offset[0])) - shadow.half_length_m
    out_y = np.abs(yx * world_x + yy * world_y + np.float32(offset[1])) - shadow.half_width_m
    outside = np.hypot(np.maximum(out_x + SHADOW_RIM_M, 0), np.maximum(out_y + SHADOW_RIM_M, 0))
    brightness[box] *= 1 - np.float32(SHADOW_DEPTH) * np.clip(1 - outside / np.float32(2 * SHADOW_RIM_M), 0, 1)


def face_colours(drawn: Drawn, atlas: Atlas, pixels: NDArray[np.intp], light: Float) -> Picture:
    """Return (N, 3) colours of pixels (flat indices) that show a face; ``light`` is the brightness of each face."""
    index = drawn.face.ravel()[pixels].astype(np.intp)
    rows, columns = np.divmod(pixels.astype(np.int32), np.int32(drawn.face.shape[1]))
    u, v = columns.astype(np.float32), rows.astype(np.float32)
    depth = np.float32(1) / drawn.inverse_depth.ravel()[pixels]
    constants = _face_constants(drawn, light)
    ax, ay, a1, dx, dy, d1, fade, lit, haze = (constants[i].take(index) for i in (*range(8), 11))
    across, down = (ax * u + ay * v + a1) * depth, (dx * u + dy * v + d1) * depth
    _, exponent = np.frexp((ax - across * fade) * depth)
    *colours, paintable = cv2.split(atlas.sample(across, down, np.clip(exponent, 0, ATLAS_LEVELS - 1)))
    share = paintable.ravel() * np.float32(1 / 255)
    painted = [
        (constants[8 + i].take(index) * share + lit) * colour.ravel() + haze * HAZE[i]
        for i, colour in enumerate(colours)
    ]
    return np.asarray(cv2.convertScaleAbs(cv2.merge(painted)), np.uint8).reshape(-1, 3)


def _face_constants(drawn: Drawn, light: Float) -> Float32:
    """Return (12, N) constants of each face for shading.

    0 to 5: rows that map a pixel to texel column and row over depth. 6: change of inverse depth per pixel column.
    7: light through haze. 8 to 10: additional light of full paint. 11: share of haze.
    """
    H, patch, faces = drawn.H, drawn.faces.patch, drawn.faces
    across = H[:, 0] * patch[:, 1:2] + H[:, 2] * patch[:, 0:1]
    down = H[:, 1] * patch[:, 3:4] + H[:, 2] * patch[:, 2:3]
    middle_m = (faces.origin + (faces.across + faces.up) / 2)[:, 2]
    clear = np.exp(-np.maximum(middle_m, 0) / HAZE_M)
    seen = light * clear
    paint = (faces.tint - 1) * seen[:, None]
    return np.vstack((across.T, down.T, H[:, 2, 0], seen, paint.T, 1 - clear)).astype(np.float32)


def daylight(across: Float, up: Float, two_sided: NDArray[np.bool_]) -> Float:
    """Return (N,) brightness of faces given in the world frame."""
    normal = np.cross(across, up)
    slant = normal @ SUN / np.linalg.norm(normal, axis=1)
    return np.where(two_sided, 0.85, AMBIENT + (1.12 - AMBIENT) * np.maximum(slant, 0))


@lru_cache(maxsize=1)
def _clouds(seed: int) -> Picture:
    """Return (512, 512, 3) a periodic patch of the sky, seen straight up."""
    noise = pink_noise((512, 512), np.random.default_rng((seed, 31)))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5, borderType=cv2.BORDER_REFLECT)
    cover = np.clip(smooth * 0.45 + 0.1, 0, 1)[..., None]
    blue = np.array((176.0, 128.0, 78.0))
    return np.asarray(blue + cover * (np.array((226.0, 214.0, 204.0)) - blue), np.uint8)


def sky_colours(camera: Camera, world_R_camera: Float, rows: int, seed: int) -> Picture:
    """Return (rows, W, 3) the sky: clouds on a high plane that fade into haze at the horizon.

    The sky is smooth, so it is drawn at half the resolution.
    """
    if rows == 0:
        return np.empty((0, camera.width, 3), np.uint8)
    size = (-(-camera.width // 2), -(-rows // 2))
    pixel_of_half = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
    ray_of_half = world_R_camera @ np.linalg.inv(camera.K) @ pixel_of_half
    plane = np.array([[40.0, 0.0, 256.0], [0.0, 40.0, 256.0], [0.0, 0.0, 1.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    sky = cv2.warpPerspective(_clouds(seed), plane @ ray_of_half, size, flags=flags, borderMode=cv2.BORDER_WRAP)
    u, v = np.arange(size[0]), np.arange(size[1])[:, None]
    x, y, z = (row[0] * u + row[2] + row[1] * v for row in ray_of_half)
    clear = np.clip(2.2 * z / np.sqrt(x * x + y * y + z * z), 0, 1).astype(np.float32)[..., None]
    faded = HAZE + (sky - HAZE) * clear
    return np.asarray(cv2.resize(cv2.convertScaleAbs(faded), None, fx=2, fy=2)[:rows, : camera.width], np.uint8)
