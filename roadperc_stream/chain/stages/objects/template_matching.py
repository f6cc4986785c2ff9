"""Template matching: normalised cross-correlation.

Source: Lewis, Fast Normalized Cross-Correlation, 1995; OpenCV's matchTemplate with TM_CCOEFF_NORMED, which is 1 where
the image is the template but for brightness and contrast.
"""

import math

import cv2
import numpy as np

from roadperc_stream.core.datatypes import Box, Correlation, Image, Mask
from roadperc_stream.core.geometry import Float

_FLAT = 0.5
"""Standard deviation in grey levels up to which pixels have no texture: what is left of rounding."""


def correlate(image: Image, template: Image, around: Box) -> Correlation | None:
    """How well the template fits everywhere in a box.

    Args:
        image: (H, W) grey.
        template: (h, w) grey, what is searched for.
        around: where it may lie, wholly, clipped to the image.

    Returns:
        None where the template is empty or flat, or does not fit into the box.
    """
    x0, y0, x1, y1 = around.rounded(image.shape[1], image.shape[0])
    rows, columns = template.shape
    if not template.size or columns > x1 - x0 or rows > y1 - y0 or float(template.std()) <= _FLAT:
        return None
    window = image[y0:y1, x0:x1]
    scores = np.asarray(cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED), np.float32)
    # Where the image is flat a correlation is 0 / 0, for which OpenCV may say 1.
    scores[_flat(window, rows, columns)] = -np.inf
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    if np.isfinite(scores[row, column]):
        scores[row, column] = _score(window[row : row + rows, column : column + columns], template)
    return Correlation(x0, y0, (columns, rows), scores)


def _score(pixels: Image, template: Image) -> float:
    """The score at one place, by whole numbers: OpenCV's is off by up to 1e-5, by how much depends on the processor."""
    one, other = (np.ravel(values).astype(np.int64) for values in (pixels, template))
    sums, count = (int(one.sum()), int(other.sum())), one.size
    common = count * int(one @ other) - sums[0] * sums[1]
    spreads = [count * int(values @ values) - total**2 for values, total in zip((one, other), sums, strict=True)]
    return common / (math.sqrt(spreads[0]) * math.sqrt(spreads[1]))


def _flat(image: Image, rows: int, columns: int) -> Mask:
    """At which positions (top left corners) a template of that size covers pixels without texture."""
    sums, squares = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    total, total_of_squares = (_sums(np.asarray(table, float), rows, columns) for table in (sums, squares))
    count = rows * columns
    total_of_squares *= count
    total_of_squares -= np.square(total, out=total)
    flat: Mask = total_of_squares <= (_FLAT * count) ** 2
    return flat


def _sums(table: Float, rows: int, columns: int) -> Float:
    """Of (rows, columns) pixels from each on, by an integral image."""
    sums: Float = table[rows:, columns:] - table[:-rows, columns:]
    sums -= table[rows:, :-columns]
    sums += table[:-rows, :-columns]
    return sums
