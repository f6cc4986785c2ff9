"""Confidence interval of a mean paired difference, by resampling blocks: neighbouring frames are not independent.

Within a log the circular block bootstrap (Politis and Romano 1992) draws blocks of neighbouring frames, as long as the
data's own correlation asks for (Politis and White 2004, with the correction of Patton, Politis and White 2009). Of
``MANY_LOGS`` logs or more, whole logs are the blocks. Quantiles of the resampled means are drawn apart by what
Student's t has over the normal distribution (Hesterberg 2015): few blocks alone give intervals that are too narrow.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from roadperc_stream.geometry import Float

LEVEL: Final = 0.99
MANY_LOGS: Final = 8
"""From so many logs on, the logs are the blocks: with fewer, Student's t of so few would hide all but the gross."""
_RESAMPLES: Final = 4000
_MOST_BLOCKS: Final = 500
"""Blocks a log is cut into at most: longer ones than the correlation asks for do no harm, and cost less."""
_SEED: Final = 20


@dataclass(frozen=True)
class Interval:
    """Bounds of a mean difference, in its unit; infinite where too little was compared to say."""

    low: float
    high: float


def mean_interval(differences: Sequence[Float]) -> Interval:
    """Interval of the mean over all values at ``LEVEL``, the same every time.

    Args:
        differences: of each log the paired differences in the order of its frames, (N,) float64, N at least 1.
    """
    values = np.concatenate(differences)
    mean = float(values.mean())
    if np.ptp(values) == 0 and values.size > 1:
        return Interval(mean, mean)
    by_log = len(differences) >= MANY_LOGS
    deviations, blocks, groups = _resampled_logs(differences) if by_log else _resampled_frames(differences)
    if blocks == groups:
        return Interval(-np.inf, np.inf)
    low, high = np.quantile(deviations, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) * _widening(blocks, blocks - groups)
    return Interval(mean + float(low), mean + float(high))


def block_length(values: Float) -> int:
    """Frames a block of the circular bootstrap should have, from the values' correlation.

    At least twice the cube root of N: in few values correlation comes out too short. (Of 200 null drives of 40 frames
    whose neighbours correlate by 0.8, 29 were marked without this bound, 12 with it; of 200 frames 9 and 6.)

    Args:
        values: (N,) float64 in the order of time.
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
    """The lag from which on ``window`` correlations in a row could be chance; else the last that could not."""
    significant = np.abs(covariance[1:] / covariance[0]) > 2 * np.sqrt(np.log10(count) / count)
    for lag in range(significant.size - window + 1):
        if not significant[lag : lag + window].any():
            return lag
    return int(np.flatnonzero(significant)[-1]) + 1 if significant.any() else 0


def _resampled_frames(differences: Sequence[Float]) -> tuple[Float, int, int]:
    """Deviations of resampled means, how many blocks, and of how many logs the blocks were drawn."""
    total, blocks = np.zeros(_RESAMPLES), 0
    for index, values in enumerate(differences):
        length = max(block_length(values), values.size // _MOST_BLOCKS, 1)
        number = int(np.ceil(values.size / length))
        picks = np.random.default_rng([_SEED, index]).integers(values.size, size=(_RESAMPLES, number))
        total += _block_means(values - values.mean(), length)[picks].mean(axis=1) * values.size
        blocks += number
    return total / sum(values.size for values in differences), blocks, len(differences)


def _block_means(values: Float, length: int) -> Float:
    """Mean of the block that starts at each frame, (N,); the log's end is followed by its start."""
    sums = np.cumsum(np.concatenate([[0.0], values, values[: length - 1]]))
    return np.asarray((sums[length:] - sums[:-length]) / length, np.float64)


def _resampled_logs(differences: Sequence[Float]) -> tuple[Float, int, int]:
    sums = np.array([values.sum() for values in differences])
    counts = np.array([values.size for values in differences])
    picks = np.random.default_rng(_SEED).integers(sums.size, size=(_RESAMPLES, sums.size))
    return sums[picks].sum(axis=1) / counts[picks].sum(axis=1) - sums.sum() / counts.sum(), sums.size, 1


def _widening(blocks: int, freedom: int) -> float:
    """How much wider an interval of so few blocks must be than the bootstrap's own."""
    tail = (1 + LEVEL) / 2
    return float(stats.t.ppf(tail, freedom) / stats.norm.ppf(tail) * np.sqrt(blocks / freedom))
