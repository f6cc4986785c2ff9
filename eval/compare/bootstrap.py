"""Confidence interval of a mean paired difference, from resampled blocks: neighbouring frames are not independent.

Within a log the circular block bootstrap (Politis and Romano 1992) draws blocks of neighbouring frames. Their length
follows from the data's correlation (Politis and White 2004, corrected by Patton, Politis and White 2009). With
``MANY_LOGS`` logs or more, whole logs are the blocks. Few blocks give intervals that are too narrow, so the interval is
widened by the ratio of Student's t to the normal quantile (Hesterberg 2015).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

LEVEL: Final = 0.99
MANY_LOGS: Final = 8
"""With this many logs or more, whole logs are the blocks; Student's t of fewer logs would hide most differences."""
_RESAMPLES: Final = 4000
_MOST_BLOCKS: Final = 500
"""Most blocks of a log; longer blocks than the correlation requires are harmless and faster."""
_SEED: Final = 20


@dataclass(frozen=True)
class Interval:
    """Bounds of a mean difference, in its unit; infinite if there are too few blocks."""

    low: float
    high: float


def mean_interval(differences: Sequence[Float], tests: int = 1) -> Interval:
    """Interval of the mean over all values at ``LEVEL``; deterministic.

    Args:
        differences: paired differences of each log in frame order, (N,) float64, N at least 1.
        tests: number of intervals that have this level together (Bonferroni).
    """
    values = np.concatenate(differences)
    mean = float(values.mean())
    if np.ptp(values) == 0 and values.size > 1:
        return Interval(mean, mean)
    by_log = len(differences) >= MANY_LOGS
    deviations, blocks, groups = _resampled_logs(differences) if by_log else _resampled_frames(differences)
    if blocks == groups:
        return Interval(-np.inf, np.inf)
    low, high = np.quantile(deviations, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) * _widening(blocks, blocks - groups, tests)
    return Interval(mean + float(low), mean + float(high))


def block_length(values: Float) -> int:
    """Number of frames in a block of the circular bootstrap, from the values' correlation.

    It is at least twice the cube root of N, because few values underestimate the correlation. (200 simulated logs
    without a difference, correlation 0.8: of those with 40 frames 29 were marked without this bound and 12 with it, of
    those with 200 frames 9 and 6.) ``values`` (N,) are float64 in frame order.
    """
    count = values.size
    size = float(np.ptp(values))
    if count < 4 or size == 0:
        return 1
    window = max(5, int(np.ceil(np.sqrt(np.log10(count)))))
    longest = int(np.ceil(np.sqrt(count))) + window
    covariance = _autocovariance(values / size, min(longest + window, count - 1))
    lags = np.arange(min(2 * _last_correlated(covariance, count, window), longest, covariance.size - 1) + 1)
    weights = np.minimum(1.0, 2.0 * (1.0 - lags / max(lags[-1], 1)))  # a flat top: 1 up to the half, then down to 0
    weighted = weights * covariance[: lags.size]
    shortest = 2 * count ** (1 / 3)
    spectrum = 2 * weighted.sum() - weighted[0]
    if spectrum <= 0:
        return int(np.ceil(shortest))
    slope = 2 * (lags * weighted).sum()
    length = (1.5 * (slope / spectrum) ** 2 * count) ** (1 / 3)
    return int(np.ceil(np.clip(length, shortest, min(3 * np.sqrt(count), count))))


def _autocovariance(values: Float, most_lag: int) -> Float:
    centred = values - values.mean()
    return np.array([centred[: values.size - lag] @ centred[lag:] for lag in range(most_lag + 1)]) / values.size


def _last_correlated(covariance: Float, count: int, window: int) -> int:
    """The lag after which ``window`` correlations in a row are insignificant; else the last significant lag."""
    significant = np.abs(covariance[1:] / covariance[0]) > 2 * np.sqrt(np.log10(count) / count)
    for lag in range(significant.size - window + 1):
        if not significant[lag : lag + window].any():
            return lag
    return int(np.flatnonzero(significant)[-1]) + 1 if significant.any() else 0


def _resampled_frames(differences: Sequence[Float]) -> tuple[Float, int, int]:
    """Deviations of the resampled means, number of blocks, number of logs."""
    total, blocks = np.zeros(_RESAMPLES), 0
    for index, values in enumerate(differences):
        length = max(block_length(values), values.size // _MOST_BLOCKS, 1)
        number = int(np.ceil(values.size / length))
        picks = np.random.default_rng([_SEED, index]).integers(values.size, size=(_RESAMPLES, number))
        total += _block_means(values - values.mean(), length)[picks].mean(axis=1) * values.size
        blocks += number
    return total / sum(values.size for values in differences), blocks, len(differences)


def _block_means(values: Float, length: int) -> Float:
    """Mean of the block that starts at each frame, (N,); blocks wrap around the end of the log."""
    sums = np.cumsum(np.concatenate([[0.0], values, values[: length - 1]]))
    return np.asarray((sums[length:] - sums[:-length]) / length, np.float64)


def _resampled_logs(differences: Sequence[Float]) -> tuple[Float, int, int]:
    sums = np.array([values.sum() for values in differences])
    counts = np.array([values.size for values in differences])
    picks = np.random.default_rng(_SEED).integers(sums.size, size=(_RESAMPLES, sums.size))
    return sums[picks].sum(axis=1) / counts[picks].sum(axis=1) - sums.sum() / counts.sum(), sums.size, 1


def _widening(blocks: int, freedom: int, tests: int) -> float:
    """Factor by which the bootstrap's interval is widened for a number of blocks, degrees of freedom and tests."""
    from scipy import special  # its import takes a quarter of a second

    tail = (1 - LEVEL) / 2
    return float(special.stdtrit(freedom, tail / tests) / special.ndtri(tail) * np.sqrt(blocks / freedom))
