"""Estimates each value of a series from its neighbours in time, without the value itself.

The model is that of a Rauch-Tung-Striebel smoother: a value with a rate, whose rate changes at random by
``process_noise`` within a second. It is solved by generalised least squares over a window around each time, without the
value at that time, so that a wrong value cannot agree with itself. Values that contradict the others lose weight
(Cauchy's weights; Huber and Ronchetti, "Robust Statistics", 2009). The window makes the answer local: a part of a
series gives the same values as the whole, apart from its ends.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float
from roadperc_stream.geometry.arrays import Mask
from roadperc_stream.system.time import NS_PER_S

_MOST: Final = 10
"""Most neighbours on either side; of more, every second, third and so on is used."""
_FEWEST: Final = 4
_LEAST_SPAN: Final = 1.2
"""Least time between the first and the last neighbour, as a multiple of the reach: some are before, some after."""
_LARGEST_MISFIT: Final = 2.0
"""Largest spread of the neighbours, as a multiple of their claimed deviations."""
_AGREEING: Final = 0.85
"""Least mean weight of the neighbours. Where a track changes to another object, they contradict each other."""
_AT_ONCE: Final = 512
"""Windows solved at once: 2 MB for each matrix."""
_ITERATIONS: Final = 4
_CONTRADICTING: Final = 2.0
"""Deviations at which a value has half its weight; the first passes are more tolerant."""
JITTER_NS: Final = 1_000_000
"""Jitter of stamps that belongs to a regular rate."""
_LEAST_STD: Final = 1e-6
_UNUSED: Final = 1e9
"""Standard deviation of an entry without a value."""


@dataclass(frozen=True)
class Smoothed:
    """(N,) values and rates at each time, and their standard deviations; NaN without an answer."""

    value: Float
    rate: Float
    value_std: Float
    rate_std: Float


def smoothed(stamp_ns: NDArray[np.int64], value: Float, std: Float, process_noise: float, reach_s: float) -> Smoothed:
    """Smooth a series at each of its times by the other values within ``reach_s``.

    Args:
        stamp_ns: (N,) times, increasing.
        value: (N,) values in any unit.
        std: (N,) their standard deviations in that unit, positive.
        process_noise: standard deviation of the change of the rate within a second, in the unit per second.
        reach_s: distance of the farthest neighbours. Times less than this before the last one have no answer: what
            came after them is not known.
    """
    found = np.full((4, len(stamp_ns)), np.nan)
    reach_ns = round(reach_s * NS_PER_S)
    first = np.searchsorted(stamp_ns, stamp_ns - reach_ns - JITTER_NS)
    last = np.searchsorted(stamp_ns, stamp_ns + reach_ns + JITTER_NS, side="right") - 1
    centre = np.arange(len(stamp_ns))
    stride = np.maximum(-(-np.maximum(centre - first, last - centre) // _MOST), 1)
    steps = np.arange(-_MOST, _MOST + 1)
    steps = steps[steps != 0]
    known = (stamp_ns + reach_ns - JITTER_NS <= stamp_ns[-1:]) & (last - first >= _FEWEST)
    spans = stamp_ns[last] - stamp_ns[first] >= _LEAST_SPAN * reach_ns - JITTER_NS
    answered = np.flatnonzero(known & spans)
    for at in np.split(answered, range(_AT_ONCE, len(answered), _AT_ONCE)) if len(answered) else ():
        index = centre[at, None] + steps * stride[at, None]
        used = (index >= first[at, None]) & (index <= last[at, None])
        index = np.where(used, index, at[:, None])
        offset_s = (stamp_ns[index] - stamp_ns[at, None]) / NS_PER_S
        found[:, at] = _solved(
            offset_s, value[index], np.where(used, np.maximum(std[index], _LEAST_STD), _UNUSED), used, process_noise
        )
    return Smoothed(*found)


def _solved(offset_s: Float, value: Float, std: Float, used: Mask, process_noise: float) -> Float:
    """Value, rate and their deviations of each window, (4, N); the arguments are (N, K)."""
    away = np.abs(offset_s)
    near, far = np.minimum(away[:, :, None], away[:, None]), np.maximum(away[:, :, None], away[:, None])
    same_side = np.sign(offset_s)[:, :, None] == np.sign(offset_s)[:, None]
    wander = np.where(same_side, process_noise**2 * near**2 * (3 * far - near) / 6, 0.0)
    expected = np.sqrt(std**2 + np.diagonal(wander, axis1=1, axis2=2))
    model = np.stack([np.ones_like(offset_s), offset_s], axis=2)
    level = np.median(value, axis=1, keepdims=True)
    weight = np.ones_like(value)
    for iteration in range(_ITERATIONS):
        noise = wander + np.eye(value.shape[1]) * (std**2 / weight)[:, :, None]
        gain = np.linalg.solve(noise, np.concatenate([model, (value - level)[:, :, None]], axis=2))
        information = model.transpose(0, 2, 1) @ gain[:, :, :2]
        covariance = np.linalg.inv(information + np.eye(2) * 1e-12)
        state = covariance @ (model.transpose(0, 2, 1) @ gain[:, :, 2:])
        off = np.where(used, (value - level - (model @ state)[:, :, 0]) / expected, np.nan)
        misfit = np.nanmedian(np.abs(off), axis=1) / 0.6745
        tolerated = _CONTRADICTING * np.maximum(misfit, 1.0) * 2.0 ** max(1 - iteration, 0)
        weight = 1 / (1 + np.nan_to_num(off / tolerated[:, None]) ** 2)
    stds = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) * np.maximum(misfit, 1.0)[:, None]
    agree = (misfit <= _LARGEST_MISFIT) & ((weight * used).sum(axis=1) >= _AGREEING * used.sum(axis=1))
    return np.where(agree, [state[:, 0, 0] + level[:, 0], state[:, 1, 0], stds[:, 0], stds[:, 1]], np.nan)
