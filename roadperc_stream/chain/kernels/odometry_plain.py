"""What ``odometry_compiled`` does, in numpy.

Patches: inverse compositional alignment (Baker and Matthews, "Lucas-Kanade 20 Years On", IJCV 56, 2004) of a shift
alone: what is solved for depends on the patch of the first image only. Means are taken away, so a change of brightness
does not matter. Every sum is added up in the order of the patch's pixels, row by row.

Reprojection: a point's error is that of its pixel, and that of its depth as far as a change of depth would shift the
pixel. Rows are weighed as Huber has it (Robust estimation of a location parameter, Annals of Mathematical Statistics
35, 1964), by the square root of his weights: so the normal equations are those of the rows.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]
REACH_PX: Final = 5
"""How far a patch reaches to either side of its centre."""
FLAT: Final = 1e-3
"""Keeps patches without texture solvable; their correlation then sorts them out."""
_SIDE: Final = 2 * REACH_PX + 1
_NEAREST_M: Final = 0.1


class Projection(NamedTuple):
    """Focal lengths and principal point, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float


class Weighting(NamedTuple):
    """Standard deviations of a pixel and, per metre, of 1 / depth; residuals in these: fully weighed, and refused."""

    std_px: float
    depth_std_per_m: float
    full: float
    gate: float


def align_patches(before: Image, before_px: Float, stretch: Float, after: Image, px: Float, iterations: int) -> Float:
    """(N,) correlations of stretched patches with an image, -1 to 1, shifted to where they fit best.

    Args:
        before: (H, W) image of the patches.
        before_px: (N, 2) their centres.
        stretch: (N, 2, 2) derivative of the pixel in ``after`` by the pixel in ``before``.
        after: (H, W) image in which they are searched.
        px: (N, 2) where the search begins; overwritten with where it ends.
        iterations: steps of the search.
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
    """Grey levels at pixels, linear between them; outside the image, and of NaN, those of its edge."""
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
    """(N,) sums of (N, P), one number after the other."""
    return np.asarray(np.add.accumulate(patches, axis=1)[:, -1] + 0.0)  # no sum that begins with 0 ends with -0


def _centred(patches: Float) -> Float:
    """(N, P) without their means."""
    flat = patches.reshape(-1, _SIDE**2)
    return np.asarray(flat - (_summed(flat) / _SIDE**2)[:, None])


def linearise(
    projection: Projection, weighting: Weighting, points_m: Float, px: Float, this_T_key: Float
) -> tuple[Float, Float, NDArray[np.uint8]]:
    """Weighted residuals and derivatives, in standard deviations.

    Args:
        projection: of both frames.
        weighting: how residuals are weighed.
        points_m: (N, 3) points in the keyframe's camera.
        px: (N, 2) where they were found in this frame.
        this_T_key: (4, 4) the motion.

    Returns:
        (2 N,) residuals, u and v of each point, 0 of one that does not agree; (2 N, 6) derivatives by a small
        translation and rotation of this camera's coordinates; (N,) 1 of points in front of the camera and within the
        gate, else 0.
    """
    fx, fy, cx, cy = projection
    X, Y, Z = points_m.T
    with np.errstate(all="ignore"):  # what lies behind the camera is written over
        x, y, z = (r[0] * X + r[1] * Y + r[2] * Z + r[3] for r in this_T_key[:3])
        ray_x, ray_y, ray_z = (r[0] * (X / Z) + r[1] * (Y / Z) + r[2] for r in this_T_key[:3])
        a, b, c, d = fx / z, -fx * x / (z * z), fy / z, -fy * y / (z * z)
        off_u, off_v = px[:, 0] - (fx * x / z + cx), px[:, 1] - (fy * y / z + cy)
        along_u, along_v = a * ray_x + b * ray_z, c * ray_y + d * ray_z
        depth_std_m = weighting.depth_std_per_m * (Z * Z)
        variance = weighting.std_px**2 + (along_u * along_u + along_v * along_v) * (depth_std_m * depth_std_m)
        off = np.sqrt((off_u * off_u + off_v * off_v) / variance)
        refused = ~((z > _NEAREST_M) & (off < weighting.gate))
        weight = np.sqrt(np.where(off > weighting.full, weighting.full / off, 1.0) / variance)
        zero = np.zeros_like(z)
        rows_u = (a, zero, b, b * y, a * z - b * x, -a * y)
        rows_v = (zero, c, d, d * y - c * z, -d * x, c * x)
        residual = np.stack((weight * off_u, weight * off_v), axis=-1)
        derivative = weight[:, None, None] * np.stack((rows_u, rows_v)).transpose(2, 0, 1)
    residual[refused] = 0.0
    derivative[refused] = 0.0
    return residual.reshape(-1), derivative.reshape(-1, 6), (~refused).view(np.uint8)
