"""Noise textures with grain at every scale, prefiltered for every distance.

Stereo matching needs texture everywhere. Grain finer than a pixel must fade, because it would flicker and differ
between the two views. Coarser grain must stay. Each level of the stack holds the grain blurred by a pixel's footprint
at one depth: z / f across the road and z^2 / (f h) along it.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from roadperc_stream.geometry import Float, Float32

TEXEL_M: Final = 0.01
COLUMNS: Final = 2048
"""Texels across the road before the grain repeats; too far apart for false stereo matches."""
ROWS: Final = 1024
"""Texels along the road before the grain repeats."""
GUARD: Final = 1
NEAREST_M: Final = 2.5
DEPTH_RATIO: Final = 1.5
LEVELS: Final = 12
TEXTURE_STD: Final = 40.0
"""Standard deviation of the sharp grain in grey levels; callers scale the contrast."""
FALL: Final = 0.75
"""Exponent by which the road's grain falls with frequency: like asphalt, a little more fine than coarse grain."""


@dataclass(frozen=True)
class GroundTexture:
    """(2 * LEVELS * (ROWS + 2 GUARD), COLUMNS + 2 GUARD) grey about 128: asphalt, then paving; rows along the road."""

    texels: NDArray[np.uint8]
    focal_px: float

    def sample(self, s_m: Float32, d_m: Float32, level: Float32, paved: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """Return grey about 128 at road coordinates of any 2-D shape; ``s_m`` is within a few hundred metres of 0."""
        column = _wrapped(d_m, COLUMNS)
        row = _wrapped(s_m, ROWS)
        block = np.rint(level)
        block += np.where(paved, np.float32(LEVELS), np.float32(0))
        block *= np.float32(ROWS + 2 * GUARD)
        row += block
        return np.asarray(cv2.remap(self.texels, column, row, cv2.INTER_LINEAR), np.uint8)


def depth_level(depth_m: Float32) -> Float32:
    """Return the level of the stack for each depth, with fractions."""
    level = np.log(depth_m)
    level -= np.float32(np.log(NEAREST_M))
    level *= np.float32(1 / np.log(DEPTH_RATIO))
    np.clip(level, 0, LEVELS - 1, out=level)
    return level


def level_depth_m(level: int) -> float:
    """Return the depth of a level in metres."""
    return NEAREST_M * DEPTH_RATIO**level


@lru_cache(maxsize=2)
def make_ground_texture(focal_px: float, height_m: float, seed: int) -> GroundTexture:
    """Return the grain for cameras with a focal length at a height above the road."""
    rng = np.random.default_rng((seed, 11))
    banks = (pink_spectrum((ROWS, COLUMNS), rng, FALL), _paving(pink_spectrum((ROWS, COLUMNS), rng, FALL)))
    stds = [float(fft.irfft2(bank, (ROWS, COLUMNS)).std()) for bank in banks]
    both = zip(banks, stds, strict=True)
    blocks = [_level(bank, std, level, focal_px, height_m) for bank, std in both for level in range(LEVELS)]
    return GroundTexture(np.concatenate(blocks), focal_px)


def pink_noise(shape: tuple[int, int], rng: np.random.Generator) -> Float32:
    """Return periodic noise with standard deviation 1 and the same energy in every octave."""
    noise = fft.irfft2(pink_spectrum(shape, rng), shape)
    return np.asarray(noise / noise.std(), np.float32)


def pink_spectrum(shape: tuple[int, int], rng: np.random.Generator, fall: float = 1.0) -> NDArray[np.complex64]:
    """Return a spectrum that falls with frequency^fall; with 1, every octave of 2-D noise has the same energy."""
    white = fft.rfft2(rng.standard_normal(shape, np.float32))
    frequency = np.hypot(fft.fftfreq(shape[0])[:, None], fft.rfftfreq(shape[1])[None, :])
    # Longer waves than a metre get the strength of one metre, or they would shade whole lanes.
    return np.asarray(white / np.maximum(frequency, 0.01) ** fall, np.complex64)


def _paving(spectrum: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return the spectrum with dark joints around slabs of about 1 m by 0.5 m."""
    noise = fft.irfft2(spectrum, (ROWS, COLUMNS))
    joints = np.zeros((ROWS, COLUMNS), np.float32)
    joints[:: ROWS // 10] = joints[1 :: ROWS // 10] = 1
    joints[:, :: COLUMNS // 40] = joints[:, 1 :: COLUMNS // 40] = 1
    return np.asarray(fft.rfft2(noise / noise.std() - 2.0 * joints), np.complex64)


def _level(
    spectrum: NDArray[np.complex64], sharp_std: float, level: int, focal_px: float, height_m: float
) -> NDArray[np.uint8]:
    """Return grain blurred by a pixel's footprint at the level's depth, scaled back to the sharp grain's deviation."""
    depth = level_depth_m(level)
    across, along = depth / focal_px, depth**2 / (focal_px * height_m)
    blur = np.outer(_gauss(fft.fftfreq(ROWS), along), _gauss(fft.rfftfreq(COLUMNS), across))
    noise = fft.irfft2(spectrum * blur.astype(np.float32), (ROWS, COLUMNS))
    # Without grain stereo finds nothing; real frames keep about half of it at long range.
    std = float(noise.std())
    strength = max(std / sharp_std, 0.45) / std
    grey = np.clip(128 + (noise - noise.mean()) * strength * TEXTURE_STD, 0, 255).astype(np.uint8)
    return np.pad(grey, GUARD, mode="wrap")


def _gauss(frequency: Float, footprint_m: float) -> Float:
    """Return the transfer function of a Gaussian with half the footprint as deviation; frequencies per texel."""
    sigma = footprint_m / TEXEL_M / 2
    return np.asarray(np.exp(-2 * (np.pi * sigma * frequency) ** 2))


def _wrapped(metres: Float32, period: int) -> Float32:
    """Return the texel coordinate within one period, including the guard."""
    turns = metres * np.float32(1 / (TEXEL_M * period))
    turns -= np.floor(turns)
    turns *= np.float32(period)
    turns += np.float32(GUARD)
    return turns
