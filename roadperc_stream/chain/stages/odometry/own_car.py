"""The own car in the lower image: rows that stay the same while the road moves.

A bonnet does not move in the image. If it counts as road, steps are too short; by its features, the camera seems to
stand. The lower a row of the image, the more its road moves. So a row that correlates in both images, below one that
does not, shows the own car.
"""

from itertools import pairwise
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.odometry.brightness import high_pass
from roadperc_stream.config import scaled
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Image

_BANDS: Final = 20
"""Bands of rows in the lower half of the image."""
_BLUR_PX: Final = 11.0
"""Side, at 960 rows, of the subtracted local mean."""
_CLIPPED: Final = 2.0
"""Multiple of the median of the grey levels' sizes at which they are clipped: markings stay in place, but are few."""
_EVERY: Final = 8
"""Every eighth level gives the median, which is exact enough."""
_MOVES: Final = 0.15
"""Correlation below which a band moves; that of the lower bands of real and rendered roads is below 0.1."""
_STAYS: Final = 0.3
"""Least correlation of a band that shows the own car; real and rendered bonnets have 0.3 to 0.9."""
_MARGIN_PX: Final = 26.0
"""Rows above the own car, at 960 rows, whose local mean of grey levels contains it."""
_GAIN: Final = 0.2
"""Weight of the latest pair of images in the mean correlation."""


def band_correlations(before: Image, after: Image, means: tuple[float, ...]) -> tuple[float, ...]:
    """Mean correlation of each band, from the top, after another pair of (H, W) images.

    ``means`` are those of the earlier pairs, empty before the first one. They stay as they are if nothing moves,
    and in images with fewer rows than bands.
    """
    if len(before) < 2 * _BANDS:
        return means
    latest = [_correlation(one, other) for one, other in zip(_bands(before), _bands(after), strict=True)]
    if min(latest) >= _MOVES:
        return means
    return tuple(mean + _GAIN * (new - mean) for mean, new in zip(means or latest, latest, strict=True))


def first_row(correlations: tuple[float, ...], rows: int) -> int:
    """The highest of an image's rows that shows the own car or its edge; ``rows`` if the own car is not visible."""
    moving = [band for band, correlation in enumerate(correlations) if correlation < _MOVES]
    first = moving[-1] + 1 if moving else 0
    stays = first > 0 and max(correlations[first:], default=0.0) > _STAYS
    return _edges(rows)[first] - round(scaled(_MARGIN_PX, rows)) if stays else rows


def without_own_car(movable: Image | None, first: int, shape: tuple[int, ...]) -> Image | None:
    """(H, W) nonzero on movable objects, and from the own car's first row downwards; None if neither is known."""
    if first >= shape[0]:
        return movable
    marked = np.zeros(shape, np.uint8) if movable is None else movable.copy()
    marked[first:] = 1
    return marked


def _correlation(a: Float32, b: Float32) -> float:
    """Correlation of the levels of a band in two images; 1 if both are uniform, 0 if one is."""
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 0 else float(not (a.any() or b.any()))


def _edges(rows: int) -> list[int]:
    return [round(edge) for edge in np.linspace(rows / 2, rows, _BANDS + 1)]


def _bands(grey: Image) -> list[Float32]:
    """(N,) grey levels of each band without slow changes of brightness, clipped."""
    edges, side = _edges(len(grey)), max(round(scaled(_BLUR_PX, len(grey))), 2) | 1
    levels = high_pass(grey[edges[0] :], side)
    bands = [levels[a - edges[0] : b - edges[0]].ravel() for a, b in pairwise(edges)]
    limits = [_CLIPPED * float(np.median(np.abs(band[::_EVERY]))) for band in bands]
    return [np.clip(band, -limit, limit) for band, limit in zip(bands, limits, strict=True)]
