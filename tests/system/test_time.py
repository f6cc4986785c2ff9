"""Seconds and nanoseconds."""

import pytest

from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns


@pytest.mark.parametrize(
    ("seconds", "time_ns"), [(0.0, 0), (1.5, 1_500_000_000), (-0.05, -50_000_000), (0.3, 3 * 10**8)]
)
def test_seconds_round_to_the_nearest_nanosecond_and_convert_back(seconds, time_ns):
    assert [seconds_to_ns(seconds + rest_s) for rest_s in (0, 0.4e-9, -0.4e-9)] == [time_ns] * 3
    assert ns_to_seconds(time_ns) == seconds
