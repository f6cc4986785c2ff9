"""The functions of ``odometry_compiled`` in numpy; only the compiled ones check sizes (ValueError).

Patches: inverse compositional alignment (Baker and Matthews, "Lucas-Kanade 20 Years On", IJCV 56, 2004) of a shift:
the normal equations depend only on the patch of the first image. Means are subtracted, so brightness does not matter.
Every sum goes through the patch's pixels row by row.

Reprojection: a point's variance combines its pixel's and the pixel shift that its depth's error causes. Each row is
multiplied by the square root of Huber's weight (Robust estimation of a location parameter, Annals of Mathematical
Statistics 35, 1964). So the products of the rows are the weighted normal equations.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]
REACH_PX: Final = 5
"""Half side of a patch."""
FLAT: Final = 1e-3
"""Keeps patches without texture solvable; their low correlation then rejects them."""
_SIDE: Final = 2 * REACH_PX + 1
_NEAREST_M: Final = 0.1


class Projection(NamedTuple):
    """Focal lengths and principal point, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float


class Weighting(NamedTuple):
    """Standard deviations of a pixel and of 1 / depth (per metre); residuals up to ``full`` have full weight.

    Residuals from ``gate`` on are rejected. Both are in standard deviations.
    """

    std_px: float
    depth_std_per_m: float
    full: float
    gate: float


def align_patches(before: Image, before_px: Float, stretch: Float, after: Image, px: Float, iterations: int) -> Float:
    """Shift stretched patches of one image to their best position in another; (N,) correlations there, -1 to 1.

    The patches are centred at (N, 2) ``before_px`` of the (H, W) image ``before``. ``stretch`` (N, 2, 2) is the
    derivative of the pixel in ``after`` (H, W) by the pixel in ``before``. The search begins at (N, 2) ``px``, which it
    overwrites with its results.
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
    for _ in range(iterations):
        error = _sampled(after, px[:, 0, None] + across, px[:, 1, None] + along) - template
        x, y = _summed(gx * error), _summed(gy * error)
        shift_x, shift_y = (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant
        px[:, 0] -= stretch[:, 0, 0] * shift_x + stretch[:, 0, 1] * shift_y
        px[:, 1] -= stretch[:, 1, 0] * shift_x + stretch[:, 1, 1] * shift_y
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


def linearise(
    projection: Projection, weighting: Weighting, points_m: Float, px: Float, this_T_key: Float
) -> tuple[Float, Float, NDArray[np.uint8]]:
    """Weighted residuals and derivatives of a (4, 4) motion, in standard deviations.

    ``points_m`` are (N, 3) in the keyframe's camera, found at (N, 2) ``px`` in this frame.

    Returns:
        (2 N,) residuals, u and v of each point; (2 N, 6) derivatives by a small translation and rotation of this
        camera's coordinates; (N,) 1 for points in front of the camera and within the gate. All are 0 for other points.
    """
    fx, fy, cx, cy = projection
    X, Y, Z = points_m.T
    with np.errstate(all="ignore"):  # points behind the camera are set to 0 below
        x, y, z = (r[0] * X + r[1] * Y + r[2] * Z + r[3] for r in this_T_key[:3])
        ray_x, ray_y, ray_z = (r[0] * (X / Z) + r[1] * (Y / Z) + r[2] for r in this_T_key[:3])
        a, b, c, d = fx / z, -fx * x / (z * z), fy / z, -fy * y / (z * z)
        off_u, off_v = px[:, 0] - (fx * x / z + cx), px[:, 1] - (fy * y / z + cy)
        along_u, along_v = a * ray_x + b * ray_z, c * ray_y + d * ray_z
        depth_std_m = weighting.depth_std_per_m * (Z * Z)
        variance = weighting.std_px**2 + (along_u * along_u + along_v * along_v) * (depth_std_m * depth_std_m)
        off = np.sqrt((off_u * off_u + off_v * off_v) / variance)
        rejected = ~((z > _NEAREST_M) & (off < weighting.gate))
        weight = np.sqrt(np.where(off > weighting.full, weighting.full / off, 1.0) / variance)
        zero = np.zeros_like(z)
        rows_u = (a, zero, b, b * y, a * z - b * x, -a * y)
        rows_v = (zero, c, d, d * y - c * z, -d * x, c * x)
        residual = np.stack((weight * off_u, weight * off_v), axis=-1)
        derivative = weight[:, None, None] * np.stack((rows_u, rows_v)).transpose(2, 0, 1)
    residual[rejected] = 0.0
    derivative[rejected] = 0.0
    return residual.reshape(-1), derivative.reshape(-1, 6), (~rejected).view(np.uint8)
