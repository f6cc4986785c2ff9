"""Seconds and nanoseconds."""

import pytest

from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns


@pytest.mark.parametrize(
    ("seconds", "time_ns"), [(0.0, 0), (1.5, 1_500_000_000), (-0.05, -50_000_000), (0.3, 3 * 10**8)]
)
def test_there_and_back(seconds, time_ns):
    assert seconds_to_ns(seconds) == time_ns
    assert ns_to_seconds(time_ns) == seconds


def test_the_nearest_nanosecond():
    assert seconds_to_ns(1.4e-9) == 1
    assert seconds_to_ns(1.6e-9) == 2
