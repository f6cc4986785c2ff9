"""What ``region_distances_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


def region_distances(
    labels: NDArray[np.int32], of_region: NDArray[np.bool_], distances_m: Float32, noise: Float32
) -> tuple[Float32, Float32]:
    """The distances of a region's pixels, each the mean of the region's known ones in the 3x3 around it.

    Those are summed in float64, each row and then the rows. Pixels without a distance are left out; an infinite one
    stays as it is.

    Args:
        labels: (h, w) of the pixels.
        of_region: (n,) of each label whether its pixels are the region's.
        distances_m: (h, w) NaN unknown and infinite beyond the depth's range.
        noise: (h, w) of the distances.

    Returns:
        (N,) distances, and (M,) the noise of those that are finite; row by row.

    Raises:
        ValueError: other sizes.
    """
    if not labels.shape == distances_m.shape == noise.shape:
        raise ValueError(f"{labels.shape} pixels, {distances_m.shape} distances and {noise.shape} noise")
    mask = of_region[labels]
    finite = mask & (distances_m < np.inf)
    sums = _sums(np.where(finite, distances_m, 0.0).astype(np.float64)).astype(np.float32)
    means = sums / np.maximum(_sums(finite.astype(np.float64)), 1.0).astype(np.float32)
    near = np.where(finite, means, distances_m)
    return near[mask & ~np.isnan(distances_m)], noise[finite]


def _sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(h, w) of the 3x3 around each."""
    padded = np.pad(values, 1)
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return rows[:-2] + rows[1:-1] + rows[2:]
