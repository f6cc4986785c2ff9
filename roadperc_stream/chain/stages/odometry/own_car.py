"""The own car in the lower image: rows that stay the same while the road moves.

A bonnet does not move in the image. As a part of the road it shows a short step, and its features a camera that stands
still. The road's image moves the more, the lower its row. A row that is alike in both images below one that is not
shows the own car.
"""

from itertools import pairwise
from typing import Final

import cv2
import numpy as np

from roadperc_stream.config import scaled
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Image

_BANDS: Final = 20
"""Bands of rows in the lower half of the image."""
_BLUR_PX: Final = 11.0
"""Side, at 960 rows, of the subtracted local mean."""
_CLIPPED: Final = 2.0
"""Multiple of the median of the grey levels' sizes at which they are clipped: markings stay in place, but are few."""
_MOVES: Final = 0.15
"""Correlation below which a band moves; that of the lower bands of real and rendered roads is below 0.1."""
_STAYS: Final = 0.3
"""Least correlation of a band that shows the own car; real and rendered bonnets have 0.3 to 0.9."""
_MARGIN_PX: Final = 26.0
"""Rows above the own car, at 960 rows, whose local mean of grey levels contains it."""
_GAIN: Final = 0.2
"""Weight of a pair of images in the mean correlation."""


def likeness(before: Image, after: Image, known: tuple[float, ...]) -> tuple[float, ...]:
    """Mean correlation of each band of two (H, W) images pixel by pixel, from the top; as known if nothing moves.

    Images with fewer rows than bands show nothing.
    """
    if len(before) < 2 * _BANDS:
        return known
    one, other = (_bands(grey) for grey in (before, after))
    alike = [_correlation(a, b) for a, b in zip(one, other, strict=True)]
    if min(alike) >= _MOVES:
        return known
    return tuple(m + _GAIN * (a - m) for m, a in zip(known or alike, alike, strict=True))


def first_row(alike: tuple[float, ...], rows: int) -> int:
    """The highest of an image's rows that shows the own car or its edge; their number without one."""
    moving = [band for band, at in enumerate(alike) if at < _MOVES]
    first = moving[-1] + 1 if moving else 0
    stays = first > 0 and max(alike[first:], default=0.0) > _STAYS
    return _edges(rows)[first] - round(scaled(_MARGIN_PX, rows)) if stays else rows


def without_own_car(movable: Image | None, first: int, shape: tuple[int, ...]) -> Image | None:
    """(H, W) nonzero on movable objects, and from the own car's first row downwards; None if nothing is known."""
    if first >= shape[0]:
        return movable
    marked = np.zeros(shape, np.uint8) if movable is None else movable.copy()
    marked[first:] = 1
    return marked


def _correlation(a: Float32, b: Float32) -> float:
    """Correlation of flat levels; 1 where nothing is seen in both images."""
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 0 else float(not (a.any() or b.any()))


def _edges(rows: int) -> list[int]:
    return [round(edge) for edge in np.linspace(rows / 2, rows, _BANDS + 1)]


def _bands(grey: Image) -> list[Float32]:
    """Flat grey levels of the bands without slow changes of brightness, clipped."""
    edges, side = _edges(len(grey)), max(round(scaled(_BLUR_PX, len(grey))), 2) | 1
    levels = grey[edges[0] :].astype(np.float32)
    levels -= cv2.blur(levels, (side, side))
    bands = [levels[a - edges[0] : b - edges[0]].ravel() for a, b in pairwise(edges)]
    limits = [_CLIPPED * float(np.median(np.abs(band))) for band in bands]
    return [np.clip(band, -limit, limit) for band, limit in zip(bands, limits, strict=True)]
