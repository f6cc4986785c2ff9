"""How far points project from where they were found, and how that changes with a small motion, by numpy.

A point's error is that of its pixel, and that of its depth as far as a change of depth would shift the pixel. Rows are
weighed as Huber has it (Robust estimation of a location parameter, Annals of Mathematical Statistics 35, 1964), by the
square root of his weights: so the normal equations are those of the rows.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

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


def linearise(
    projection: Projection,
    weighting: Weighting,
    points_m: Float,
    px: Float,
    this_T_key: Float,
    residual: Float,
    derivative: Float,
    agrees: NDArray[np.uint8],
) -> None:
    """Write weighted residuals and derivatives, in standard deviations.

    Args:
        projection: of both frames.
        weighting: how residuals are weighed.
        points_m: (N, 3) points in the keyframe's camera.
        px: (N, 2) where they were found in this frame.
        this_T_key: (4, 4) the motion.
        residual: (2 N,), written: u and v of each point; 0 of one that does not agree.
        derivative: (2 N, 6), written: by a small translation and rotation of this camera's coordinates.
        agrees: (N,), written: 1 of points in front of the camera and within the gate, else 0.

    Raises:
        ValueError: sizes that do not belong together.
    """
    require_belonging(*(a.shape for a in (points_m, px, this_T_key, residual, derivative, agrees)))
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
        residual.reshape(-1, 2)[:] = np.stack((weight * off_u, weight * off_v), axis=-1)
        derivative.reshape(-1, 2, 6)[:] = weight[:, None, None] * np.stack((rows_u, rows_v)).transpose(2, 0, 1)
    residual.reshape(-1, 2)[refused] = 0.0
    derivative.reshape(-1, 2, 6)[refused] = 0.0
    agrees[:] = ~refused


def require_belonging(*shapes: tuple[int, ...]) -> None:
    """Check the shapes of the arrays that ``linearise`` takes, in its order.

    Raises:
        ValueError: sizes that do not belong together.
    """
    count = shapes[-1][0]
    if shapes[:-1] != ((count, 3), (count, 2), (4, 4), (2 * count,), (2 * count, 6)):
        raise ValueError(f"points, pixels, motion and rows of {shapes}: expected one number of points")
