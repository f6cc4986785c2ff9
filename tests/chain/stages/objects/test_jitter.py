"""The jitter of distances: drawn with a known deviation, on a line and off it."""

from math import sqrt

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects import rate_filter
from roadperc_stream.chain.stages.objects.rate_filter import Jitter

STD_M = 0.15
FILTERED = rate_filter.start(10.0, 0.5, 1.0)


def after(distances_m, stamps_ns):
    jitter = Jitter.of_first(stamps_ns[0], distances_m[0], STD_M)
    for stamp_ns, distance_m in zip(stamps_ns[1:], distances_m[1:], strict=True):
        jitter = jitter.after(stamp_ns, FILTERED, distance_m, STD_M)
    return jitter


@pytest.mark.parametrize("true_m", [0.02, 0.1])
@pytest.mark.parametrize("steps_ns", [(50_000_000,), (20_000_000, 90_000_000)])
def test_the_deviation_about_a_line_is_found_however_the_frames_lie(true_m, steps_ns):
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        stamps = np.cumsum([steps_ns[k % len(steps_ns)] for k in range(100)])
        distances = 40.0 - 7.0 * stamps / 1e9 + rng.normal(0, true_m, len(stamps))
        found.append(after(distances.tolist(), stamps.tolist()).variance)
    assert sqrt(np.mean(found)) == pytest.approx(true_m, rel=0.2)


def test_no_more_than_a_distance_may_be_off():
    stamps = [k * 50_000_000 for k in range(1, 60)]
    assert sqrt(after([10.0 + (k % 2) for k in range(59)], stamps).variance) <= STD_M + 1e-9


def test_a_distance_far_off_counts_for_less():
    jitter = Jitter(1e-4, 10.0, 1, 10.0)
    filtered = rate_filter.start(10.0, 0.01, 0.1)
    near, off = (jitter.std_m(filtered, distance_m, STD_M) for distance_m in (10.01, 10.2))
    assert (near, off) == (pytest.approx(0.01), pytest.approx(0.1, rel=0.02))
    assert jitter.std_m(filtered, 12.0, STD_M) == STD_M


@pytest.mark.parametrize(("true_m", "expected"), [(0.02, 0.25), (1.0, 1.0), (2.0, 4.0), (50.0, 10.0)])
def test_the_variance_of_the_rate_follows_the_innovations(true_m, expected):
    """Those of a filter that expects 1 m, with distances as regular as a line."""
    rng = np.random.default_rng(0)
    jitter = Jitter.of_first(1, 10.0, STD_M)
    scales = []
    for k in range(2, 400):
        filtered = rate_filter.start(10.0 - rng.normal(0, true_m), 1.0, 1.0)
        jitter = jitter.after(k * 50_000_000, filtered, 10.0, STD_M)
        scales.append(jitter.rate_var_scale)
    assert np.median(scales[100:]) == pytest.approx(expected, rel=0.2)
