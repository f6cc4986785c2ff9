"""The error that the depths of one image share, from depths of the same points in two images.

A motion from points is as long as their depths are large, so a common error of all depths changes its length by the
same share. Its residuals do not show the error. The next image shows it if its own error differs: the ratio of a
point's depth to the depth that the motion predicts is the ratio of both errors. An error that is the same in all
images, such as a wrong unit, stays hidden.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.motion import Motion, cells
from roadperc_stream.geometry import Float, Float32, project, transform

_LEAST_POINTS: Final = 5
"""Minimum number of points with known depths in a used cell."""
_LEAST_CELLS: Final = 4
_FRAMES: Final = 20
"""Number of frames over which the variance is averaged."""
_FEW: Final = 2.0
"""Additional variance, as a share, over the number of frames that show it: a few small ratios may be chance."""
_MAD: Final = 1.4826
"""Standard deviation by the median distance from the median."""
_SMALL_SAMPLE: Final = 0.8
"""The median distance of N values is short by about this share of 1 / N."""
_CORNERS: Final = np.array(((0, 0), (1, 0), (0, 1), (1, 1)))


@dataclass(frozen=True)
class DepthScale:
    """The mean square of the share by which all depths of an image are wrong, and how many frames showed it."""

    mean_square: float = 0.0
    frames: int = 0

    @property
    def variance(self) -> float:
        """The variance of the share."""
        return max(self.mean_square, 0.0) * (1.0 + _FEW / max(self.frames, 1))

    def after(self, frame: TrackingFrame, key_px: Float32, motion: Motion) -> "DepthScale":
        """The state after a frame, by the motion since a keyframe with depth and with (N, 2) features."""
        if frame.depth_m is None:
            return self
        points_m = transform(motion.this_T_key, motion.points_m[motion.inliers])
        expected_m = points_m[:, 2]
        # The point's predicted pixel: on a road at a grazing angle, an error of the tracked pixel changes the depth.
        px = frame.whole(project(frame.camera, points_m).astype(np.float32))
        with np.errstate(divide="ignore", invalid="ignore"):  # points behind the camera
            ratios = np.log(_depths_m(frame.depth_m, px) / expected_m)
        square = shared_square(ratios, key_px[motion.inliers], frame.grey.shape[1], 1.0 / expected_m**2)
        if square is None:
            return self
        frames = min(self.frames + 1, _FRAMES)
        return DepthScale(self.mean_square + (square - self.mean_square) / frames, frames)


def _depths_m(depth_m: Float32, px: Float32) -> Float:
    """(N,) depths at (N, 2) pixels, bilinear in the inverse depth, which is linear on a plane; NaN unknown."""
    height, width = depth_m.shape
    first = np.clip(np.floor(px), 0, (width - 2, height - 2)).astype(int)
    right, down = np.clip(px - first, 0.0, 1.0).T
    columns, rows = (first[:, None] + _CORNERS).T
    weights = np.stack(((1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(1.0 / np.sum(weights / depth_m[rows, columns], axis=0), np.float64)


def shared_square(ratios: Float, px: Float32, width: int, weights: Float) -> float | None:
    """The square of the error that all depths share, by the logarithms of (N,) depth ratios; None if too few are known.

    Points at (N, 2) pixels in one cell of the image err together. The cells' medians have a mean, and a spread that
    averages out over the cells. The noise of the medians is subtracted, so the square can be negative. ``weights`` are
    (N,) shares of the points in the motion's length. Half of a ratio's variance belongs to each image.
    """
    known = np.isfinite(ratios)
    ratios, weights = ratios[known], weights[known]
    _, cell, count = np.unique(cells(px[known], width), return_inverse=True, return_counts=True)
    used = count >= _LEAST_POINTS
    if np.sum(used) < _LEAST_CELLS:
        return None
    medians = _medians(ratios, cell, count)
    apart = _medians(np.abs(ratios - medians[cell]), cell, count)
    noises = (np.pi / 2) * (_MAD * apart) ** 2 * count / (count - _SMALL_SAMPLE) ** 2
    weight = np.asarray(np.bincount(cell, weights)[used], np.float64)
    share = weight / weight.sum()
    mean, noise = _weighted_median(medians[used], share), _weighted_median(noises[used], share)
    spread = _MAD * _weighted_median(np.abs(medians[used] - mean), share)
    return (mean**2 + (spread**2 - 2 * noise) * float(share @ share)) / 2


def _medians(values: Float, cell: NDArray[np.intp], count: NDArray[np.intp]) -> Float:
    """The median in each cell; ``cell`` (N,) numbers the cells, ``count`` is the number of values in each."""
    ordered, first = values[np.lexsort((values, cell))], np.cumsum(count) - count
    return np.asarray((ordered[first + (count - 1) // 2] + ordered[first + count // 2]) / 2, np.float64)


def _weighted_median(values: Float, shares: Float) -> float:
    """The median of values with shares whose sum is 1."""
    order = np.argsort(values)
    return float(np.interp(0.5, np.cumsum(shares[order]) - shares[order] / 2, values[order]))
