"""Corruptions of (H, W, 3) uint8 images, with the formulas of ImageNet-C and RoboBEV (see ``levels``).

Blurs are in pixels, whatever the size of the image, as in ImageNet-C.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import cv2
import numpy as np

from roadperc_stream.formats.images import decode_bgr, encode_jpeg
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Image

from .draw import Draw


def _bytes(values: Any) -> Image:
    """Values of 0 to 1 as uint8, rounded down as in ImageNet-C."""
    return np.asarray(np.clip(values, 0, 1) * 255).astype(np.uint8)


def impulse_noise(pixels: Image, share: float, draw: Draw) -> Image:
    """A share of the values is black or white, half of it each."""
    chance = draw.rng("message").random(pixels.shape, np.float32)
    return np.where(chance < share / 2, np.uint8(0), np.where(chance < share, np.uint8(255), pixels))


def defocus_blur(pixels: Image, disk: tuple[int, float], _draw: Draw) -> Image:
    """The mean over a disk whose edge is smoothed."""
    radius, edge = disk
    half, smooth = (8, (3, 3)) if radius <= 8 else (radius, (5, 5))
    reach = np.arange(-half, half + 1)
    kernel = (reach**2 + reach[:, None] ** 2 <= radius**2).astype(np.float32)
    return _bytes(cv2.filter2D(pixels / np.float32(255), -1, cv2.GaussianBlur(kernel / kernel.sum(), smooth, edge)))


def motion_blur(pixels: Image, trail: tuple[int, float], draw: Draw) -> Image:
    """The mean along a trail of random direction; its weights fall as one half of a normal distribution."""
    radius, std = trail
    angle = math.radians(draw.rng("stamp").uniform(-45, 45))
    steps = np.arange(2 * radius + 1)
    weights = np.exp(-(steps**2) / (2 * std**2))
    rows, columns = (np.ceil(steps * part - 0.5).astype(int) for part in (math.sin(angle), math.cos(angle)))
    kernel = np.zeros((4 * radius + 1, 4 * radius + 1), np.float32)
    np.add.at(kernel, (2 * radius + rows, 2 * radius + columns), weights / weights.sum())
    return _bytes(cv2.filter2D(pixels / np.float32(255), -1, kernel, borderType=cv2.BORDER_REPLICATE))


def fog(pixels: Image, density_decay: tuple[float, float], draw: Draw) -> Image:
    """A random pattern of white, added and scaled back so that the brightest pixel stays."""
    (density, decay), (height, width) = density_decay, pixels.shape[:2]
    side = 1 << (max(height, width) - 1).bit_length()
    pattern = plasma(side, decay, draw.rng("stamp"))[:height, :width, None]
    values = pixels / np.float32(255)
    brightest = values.max()
    return _bytes((values + density * pattern) * brightest / (brightest + density))


def plasma(side: int, decay: float, rng: np.random.Generator) -> Float32:
    """(side, side) heights of 0 to 1 by the diamond-square algorithm on a torus; ``side`` is a power of 2.

    Each halving of the step divides the random part by ``decay``. Source: Fournier, Fussell and Carpenter, "Computer
    Rendering of Stochastic Models", 1982; the amplitude falls with its square, as in ImageNet-C.
    """
    heights = np.zeros((side, side), np.float32)
    step, amplitude = side, 100.0

    def middle(of: Float32) -> Float32:
        noise = amplitude * rng.uniform(-amplitude, amplitude, of.shape)
        return of / np.float32(4) + noise.astype(np.float32)

    while step > 1:
        half = step // 2
        corners = heights[::step, ::step]
        rows = corners + np.roll(corners, -1, 0)
        centres = middle(rows + np.roll(rows, -1, 1))
        heights[half::step, half::step] = centres
        across = centres + np.roll(centres, 1, 0) + corners + np.roll(corners, -1, 1)
        heights[::step, half::step] = middle(across)
        along = centres + np.roll(centres, 1, 1) + corners + np.roll(corners, -1, 0)
        heights[half::step, ::step] = middle(along)
        step, amplitude = half, amplitude / decay
    heights -= heights.min()
    return np.asarray(heights / heights.max(), np.float32)


def brightness(pixels: Image, more: float, _draw: Draw) -> Image:
    """A higher value in HSV, with the same hue and saturation: all channels are scaled alike, black becomes grey."""
    values = pixels / np.float32(255)
    before = values.max(axis=2, keepdims=True)
    after = np.minimum(before + more, 1)
    return _bytes(np.where(before > 0, values * after / np.maximum(before, 1 / 255), after))


def low_light(pixels: Image, light: tuple[float, float, float], draw: Draw) -> Image:
    """A darker image, with the noise of few photons and of the sensor."""
    (brightest, photons, std), rng, values = light, draw.rng("message"), pixels.astype(np.float32)
    dark = brightest * ((values - values.min()) / max(float(np.ptp(values)), 1)) ** 2
    noisy = np.clip(rng.poisson(dark * photons) / photons, 0, 1)
    return _bytes(noisy + std * rng.standard_normal(noisy.shape, np.float32))


def is_crashed(share: float, draw: Draw) -> bool:
    """Whether the camera has crashed: once in the log, for a share of it."""
    begin = draw.rng("log").uniform(0, 1 - share)
    return bool(begin <= draw.share <= begin + share)


IMAGES: Final[Mapping[str, Callable[[Image, Any, Draw], Image]]] = {
    "gaussian_noise": lambda x, std, draw: _bytes(x / 255 + std * draw.rng("message").standard_normal(x.shape)),
    "shot_noise": lambda x, photons, draw: _bytes(draw.rng("message").poisson(x * (photons / 255)) / photons),
    "impulse_noise": impulse_noise,
    "defocus_blur": defocus_blur,
    "motion_blur": motion_blur,
    "fog": fog,
    "brightness": brightness,
    "contrast": lambda x, factor, _: _bytes((factor * x + (1 - factor) * x.mean(axis=(0, 1))) / 255),
    "jpeg_compression": lambda x, quality, _: decode_bgr(encode_jpeg(x, quality)),
    "low_light": low_light,
    "camera_crash": lambda x, share, draw: np.zeros_like(x) if is_crashed(share, draw) else x,
}
"""By name: the function of the pixels, the constants of the severity, and the random numbers."""
