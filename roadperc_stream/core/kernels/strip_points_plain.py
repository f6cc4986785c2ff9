"""Points of a strip of road and the cells that they lie in, by numpy."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.kernels.ray_points_plain import Rays, points_along_rays

Float32 = NDArray[np.float32]


class Strip(NamedTuple):
    """A strip of ground ahead: its length, half its width, the side of its cells, all metres, and cells side by side.

    Points are numbers of single precision, and so are what they are compared with.
    """

    length_m: float
    half_width_m: float
    step_m: float
    across: int


def points_on_strip(
    strip: Strip, depth_m: Float32, rays: Rays, abd: Float32, among: NDArray[np.uint8]
) -> tuple[Float32, NDArray[np.int32]]:
    """The points of marked pixels that lie on a strip, and their cells.

    Args:
        strip: the strip.
        depth_m: (H, W) of the pixels; those of NaN lie nowhere.
        rays: of the pixels.
        abd: (3,) the road as a x + b y + z = d.
        among: (H, W) 0 or 1, the pixels that count.

    Returns:
        (3, N) x, y and height over the road, pixels row by row, and (N,) cells, ``across`` for each step ahead; at the
        left edge y may be rounded up to the next one's.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    require_belonging(depth_m.shape, *(part.shape for part in rays), abd.shape, among.shape)
    points = np.empty((3, *depth_m.shape), np.float32)
    points_along_rays(depth_m, *rays, points)
    x, y, z = (numbers[among.view(bool)] for numbers in points)
    length, half, step = (np.float32(number) for number in strip[:3])
    inside = (x >= 0) & (x < length) & (np.abs(y) < half)
    x, y, z = x[inside], y[inside], z[inside]
    cells = (x / step).astype(np.int32) * np.int32(strip.across) + ((y + half) / step).astype(np.int32)
    return np.stack((x, y, z - (abd[2] - abd[0] * x - abd[1] * y))), cells


def require_belonging(*shapes: tuple[int, ...]) -> None:
    """Check the shapes of the arrays that ``points_on_strip`` takes, in its order.

    Raises:
        ValueError: sizes that do not belong together.
    """
    depth, column, row, start, abd, among = shapes
    if among != depth or (column, row, start, abd) != ((3, depth[1]), (3, depth[0]), (3,), (3,)):
        raise ValueError(f"rays or marks of other sizes than {depth} depths")
