"""Noise in clean pictures, as sensors and networks have it."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float32

from .ground import FAR_M

Tags = NDArray[np.uint8]

REFERENCE_WIDTH: Final = 1280
WOBBLE_CELL_PX: Final = 22
"""Distance, at the reference width, over which the wobble of borders changes."""
WOBBLE_PX: Final = 75.0
"""Deviation of borders per share of noise, at the reference width: 1.5 px at 0.02."""
BLOB_RADIUS_PX: Final = (6.0, 34.0)
SALT: Final = 0.03
"""Single wrong pixels, as a share of the noise."""


def noisy_tags(tags: Tags, share: float, rng: np.random.Generator) -> Tags:
    """(H, W) tags as a network errs: borders wobble, blobs are taken for another class, a few pixels are just wrong.

    Args:
        tags: the clean ones.
        share: of the image that blobs cover; the borders wobble in proportion.
        rng: decides everything.
    """
    scale = tags.shape[1] / REFERENCE_WIDTH
    classes = np.flatnonzero(np.bincount(tags.ravel()))
    result = _wobbled(tags, WOBBLE_PX * share * scale, WOBBLE_CELL_PX * scale, rng)
    wrong = np.full(tags.shape, 255, np.uint8)
    area = 0.0
    while area < share * tags.size:
        low, high = (radius * scale for radius in BLOB_RADIUS_PX)
        axes = rng.uniform(low, high, 2)
        centre = rng.uniform((0, 0), tags.shape[::-1])
        _ellipse(wrong, centre, axes, float(rng.uniform(0, 180)), int(rng.choice(classes)))
        area += float(np.pi * axes.prod())
    wrong = _wobbled(wrong, 3.0 * scale, WOBBLE_CELL_PX * scale / 2, rng)
    np.copyto(result, wrong, where=wrong != 255)
    salt = rng.integers(0, tags.size, round(SALT * share * tags.size))
    result.ravel()[salt] = rng.choice(classes, len(salt))
    return result


def _ellipse(picture: Tags, centre: NDArray[np.float64], axes: NDArray[np.float64], angle: float, tag: int) -> None:
    x, y = (round(c) for c in centre)
    a, b = (max(round(c), 1) for c in axes)
    cv2.ellipse(picture, (x, y), (a, b), angle, 0, 360, tag, -1)


def _wobbled(tags: Tags, deviation_px: float, cell_px: float, rng: np.random.Generator) -> Tags:
    """Every pixel taken from a place nearby; the displacement is smooth over a cell."""
    height, width = tags.shape
    cells = (max(int(width / cell_px), 1) + 3, max(int(height / cell_px), 1) + 3)
    shifts = []
    for _ in range(2):
        coarse = rng.standard_normal((cells[1], cells[0]), np.float32)
        fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        shifts.append(fine * np.float32(deviation_px / max(float(fine.std()), 1e-6)))
    columns, rows = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    moved = cv2.remap(tags, shifts[0] + columns, shifts[1] + rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.uint8)


def noisy_depth(depth_m: Float32, relative_std: float, rng: np.random.Generator) -> Float32:
    """Depth with an independent relative error in every pixel; the sky stays where it is."""
    factor = rng.standard_normal(depth_m.shape, np.float32) * np.float32(relative_std) + np.float32(1)
    noisy = np.clip(depth_m * factor, 0, FAR_M)
    return np.where(depth_m >= FAR_M, np.float32(FAR_M), noisy).astype(np.float32)


def noisy_rgb(rgb: NDArray[np.uint8], std: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Colours with independent noise in grey levels."""
    noise = rng.standard_normal(rgb.shape, np.float32) * np.float32(std)
    return np.clip(np.rint(rgb + noise), 0, 255).astype(np.uint8)
