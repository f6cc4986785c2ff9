"""Where a patch of one image lies in another: normalised cross-correlation.

Source: Lewis, Fast Normalized Cross-Correlation, 1995; OpenCV's matchTemplate with TM_CCOEFF_NORMED, which is 1 where
the image is the patch but for brightness and contrast.
"""

import cv2
import numpy as np

from roadperc_stream.core.datatypes import Box, Correlation, Image, Mask

_FLAT = 0.5
"""Standard deviation in grey levels up to which pixels show nothing: what is left of rounding."""


def find_patch(image: Image, patch: Image, around: Box | None, min_score: float) -> tuple[Box, float] | None:
    """The place in the image that looks most like the patch.

    Args:
        image: (H, W) grey.
        patch: (h, w) grey, what is looked for.
        around: the patch is looked for wholly inside this box, clipped to the image; None is the whole image.
        min_score: least correlation that counts as found, -1 to 1.

    Returns:
        The patch's box in the image and its correlation; None where nothing reaches ``min_score``, the patch is empty
        or flat, or it does not fit into the box.
    """
    found = correlate(image, patch, around)
    return None if found is None else found.match(min_score)


def correlate(image: Image, patch: Image, around: Box | None) -> Correlation | None:
    """How well the patch fits everywhere in a box.

    Args:
        image: (H, W) grey.
        patch: (h, w) grey, what is looked for.
        around: where it may lie, wholly, clipped to the image; None is the whole image.

    Returns:
        None where the patch is empty or flat, or does not fit into the box.
    """
    height, width = image.shape
    x0, y0, x1, y1 = (0, 0, width, height) if around is None else around.rounded(width, height)
    rows, columns = patch.shape
    if not patch.size or float(patch.std()) <= _FLAT or columns > x1 - x0 or rows > y1 - y0:
        return None
    window = image[y0:y1, x0:x1]
    scores = np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED), np.float32)
    # Where the image is flat a correlation is 0 / 0, for which OpenCV may say 1.
    scores[_flat(window, rows, columns)] = -np.inf
    return Correlation(x0, y0, (columns, rows), scores)


def _flat(image: Image, rows: int, columns: int) -> Mask:
    """At which places (top left corners) a patch of that size covers pixels that show nothing."""
    sums, squares = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    total, total_of_squares = (
        table[rows:, columns:] - table[:-rows, columns:] - table[rows:, :-columns] + table[:-rows, :-columns]
        for table in (np.asarray(sums, float), np.asarray(squares, float))
    )
    count = rows * columns
    flat: Mask = total_of_squares * count - total**2 <= (_FLAT * count) ** 2
    return flat
