"""The function of ``odometry_compiled`` in numpy; only the compiled one checks sizes (ValueError).

Inverse compositional alignment (Baker and Matthews, "Lucas-Kanade 20 Years On", IJCV 56, 2004) of a shift: the normal
equations depend only on the patch of the first image. Means are subtracted, so brightness does not matter. Every sum
goes through the patch's pixels row by row.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]
REACH_PX: Final = 5
"""Half side of a patch."""
FLAT: Final = 1e-3
"""Keeps patches without texture solvable; their low correlation then rejects them."""
_SIDE: Final = 2 * REACH_PX + 1


def align_patches(
    before: Image, before_px: Float, stretch: Float, after: Image, px: Float, iterations: int, still_px: float
) -> Float:
    """Shift stretched patches of one image to their best position in another; (N,) correlations there, -1 to 1.

    The patches are centred at (N, 2) ``before_px`` of the (H, W) image ``before``. ``stretch`` (N, 2, 2) is the
    derivative of the pixel in ``after`` (H, W) by the pixel in ``before``. The search begins at (N, 2) ``px``, which it
    overwrites with its results, and ends at the last iteration or at a shift below ``still_px``.
    """
    down, right = np.mgrid[-REACH_PX - 1 : REACH_PX + 2, -REACH_PX - 1 : REACH_PX + 2].astype(float)
    around = _sampled(before, before_px[:, 0, None, None] + right, before_px[:, 1, None, None] + down)
    template = _centred(around[:, 1:-1, 1:-1])
    gx = _centred(0.5 * (around[:, 1:-1, 2:] - around[:, 1:-1, :-2]))
    gy = _centred(0.5 * (around[:, 2:, 1:-1] - around[:, :-2, 1:-1]))
    xx, xy, yy = _summed(gx * gx) + FLAT, _summed(gx * gy), _summed(gy * gy) + FLAT
    determinant = xx * yy - xy * xy
    down, right = (offset[1:-1, 1:-1].ravel() for offset in (down, right))
    across = stretch[:, 0, 0, None] * right + stretch[:, 0, 1, None] * down
    along = stretch[:, 1, 0, None] * right + stretch[:, 1, 1, None] * down
    moving = np.arange(len(px))
    for _ in range(iterations):
        i = moving
        error = _sampled(after, px[i, 0, None] + across[i], px[i, 1, None] + along[i]) - template[i]
        x, y = _summed(gx[i] * error), _summed(gy[i] * error)
        shift_x = (yy[i] * x - xy[i] * y) / determinant[i]
        shift_y = (xx[i] * y - xy[i] * x) / determinant[i]
        step_x = stretch[i, 0, 0] * shift_x + stretch[i, 0, 1] * shift_y
        step_y = stretch[i, 1, 0] * shift_x + stretch[i, 1, 1] * shift_y
        px[i] -= np.stack((step_x, step_y), axis=-1)
        moving = i[~(step_x * step_x + step_y * step_y < still_px * still_px)]
    found = _centred(_sampled(after, px[:, 0, None] + across, px[:, 1, None] + along))
    power = _summed(found * found) * _summed(template * template)
    return np.asarray(_summed(found * template) / np.sqrt(power + FLAT))


def _sampled(image: Image, x: Float, y: Float) -> Float:
    """Grey levels at pixels, interpolated linearly; outside the image and for NaN those of its edge."""
    height, width = image.shape
    x, y = (np.where(at > 0, at, 0.0) for at in (x, y))
    x, y = np.where(x < width - 1, x, width - 1), np.where(y < height - 1, y, height - 1)
    left, top = x.astype(np.intp), y.astype(np.intp)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    x, y = x - left, y - top
    levels = image.astype(float)
    upper = levels[top, left] + x * (levels[top, right] - levels[top, left])
    lower = levels[below, left] + x * (levels[below, right] - levels[below, left])
    result: Float = upper + y * (lower - upper)
    return result


def _summed(patches: Float) -> Float:
    """(N,) sums of (N, P), from first to last."""
    return np.asarray(np.add.accumulate(patches, axis=1)[:, -1] + 0.0)  # a sum that begins with 0 is never -0


def _centred(patches: Float) -> Float:
    """(N, P) patches minus their means."""
    flat = patches.reshape(-1, _SIDE**2)
    return np.asarray(flat - (_summed(flat) / _SIDE**2)[:, None])
