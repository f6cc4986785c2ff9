"""Exposure: the brightness and contrast of one image carried over to another, and images that show nothing.

Optical flow and patch alignment assume constant brightness. Automatic exposure changes it from frame to frame, by
nearly the same gain and offset for all pixels. Quantiles of both histograms give the two numbers without matches.
"""

from typing import Final

import cv2
import numpy as np

from roadperc_stream.geometry import Float, Float32
from roadperc_stream.model import Image

_SHARES: Final = np.linspace(0.05, 0.95, 19)
"""The compared quantiles: lamps and deep shadows at either end are not typical of the frame."""
_DARKEST: Final = 2.0
_BRIGHTEST: Final = 253.0
"""Quantiles outside these grey levels may be clipped."""
_LEAST_QUANTILES: Final = 4
_NOTICEABLE: Final = 8.0
"""Grey levels by which a quantile must differ; other images enter the view as well, and flow tolerates less."""
_COARSE: Final = (16, 12)
_LESS: Final = 0.7
"""An exposure must reduce the difference of most of the coarse pixels to this share; a new object does not."""
_LEAST_RANGE: Final = 12
_LEAST_SHARE: Final = 0.001
"""Share of the pixels that a grey level must have to count."""
_EVERY: Final = 4
"""Every fourth pixel in both directions is counted, which is exact enough."""


def shows_nothing(grey: Image) -> bool:
    """Whether a (H, W) image is black, white or nearly uniform: its grey levels are within a narrow range."""
    levels = np.flatnonzero(_shares(grey) > _LEAST_SHARE)
    return bool(np.ptp(levels) < _LEAST_RANGE)


def high_pass(grey: Image, side_px: int) -> Float32:
    """(H, W) an image minus its local mean in squares of this odd side: without slow changes of brightness."""
    means = cv2.boxFilter(grey, cv2.CV_32F, (side_px, side_px))
    return np.asarray(cv2.subtract(grey, means, dtype=cv2.CV_32F), np.float32)


def equalised(before: Image, after: Image) -> tuple[Image, Image]:
    """Two (H, W) images with one exposure, that of the second; as they are if they are about equally bright.

    The second image is clipped to the levels that the first one can have, since it shows no more.
    """
    levels, wanted = (_quantiles(image) for image in (before, after))
    if np.abs(levels - wanted).max() < _NOTICEABLE:
        return before, after
    whole = np.all([(at > _DARKEST) & (at < _BRIGHTEST) for at in (levels, wanted)], axis=0)
    if int(np.sum(whole)) < _LEAST_QUANTILES or np.ptp(levels[whole]) == 0:
        return before, after
    gain = np.ptp(wanted[whole]) / np.ptp(levels[whole])
    offset = float(np.median(wanted[whole] - gain * levels[whole]))
    table = np.clip(np.rint(gain * np.arange(256) + offset), 0, 255).astype(np.uint8)
    dim, bright = (_coarse(image) for image in (before, after))
    if _difference(table[dim], np.clip(bright, table[0], table[-1])) >= _LESS * _difference(dim, bright):
        return before, after
    return np.asarray(cv2.LUT(before, table), np.uint8), np.clip(after, table[0], table[-1])


def _coarse(grey: Image) -> Image:
    return np.asarray(cv2.resize(grey[::_EVERY], _COARSE, interpolation=cv2.INTER_AREA), np.uint8)


def _difference(one: Image, other: Image) -> float:
    """Median difference of coarse images, which hardly depends on motion."""
    return float(np.median(np.abs(np.subtract(one, other, dtype=float))))


def _shares(grey: Image) -> Float:
    """(256,) share of the pixels at each grey level."""
    sampled = np.ascontiguousarray(grey[::_EVERY, ::_EVERY])
    counts = cv2.calcHist([sampled], [0], None, [256], [0, 256])
    return np.asarray(counts, np.float64).ravel() / sampled.size


def _quantiles(grey: Image) -> Float:
    """Grey levels at ``_SHARES``, interpolated within a level."""
    return np.asarray(np.interp(_SHARES, np.cumsum(_shares(grey)), np.arange(256) + 0.5))
