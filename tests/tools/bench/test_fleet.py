"""Fleets whose time is known, or has a bound."""

import pytest
import simpy
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.tools.bench.fleet import FleetCosts, FleetSplit, SharedLink, bounds, simulate

FREE = 1e18
ALONE = FleetCosts(
    frames_per_s=10.0,
    frame_s=0.2,
    start_s=1.0,
    frame_bytes=1e6,
    result_bytes=0.0,
    store_bytes_per_s=FREE,
    worker_bytes_per_s=FREE,
    driver_s=0.0,
)
"""A log of a second takes two seconds, and one to start; the store and the driver take none."""
LENGTHS_S = [5.0, 1.0, 3.0, 2.0]
lengths = st.lists(st.floats(0.1, 1000), min_size=1, max_size=30)


def costs(**changed):
    return FleetCosts(**(ALONE.__dict__ | changed))


def test_one_worker_takes_the_sum():
    assert simulate(LENGTHS_S, 1, ALONE).seconds == pytest.approx(2 * 11 + 4)


def test_more_workers_than_logs_take_as_long_as_the_longest_log():
    found = simulate(LENGTHS_S, 100, ALONE)
    assert found.seconds == pytest.approx(2 * 5 + 1)
    assert found.bottleneck == "longest log"


def test_two_workers_take_the_longest_first():
    assert simulate(LENGTHS_S, 2, ALONE).seconds == pytest.approx(14)  # 11 and 3; 7 and 5


def test_a_store_that_is_full_bounds_the_batch():
    found = simulate([10.0] * 200, 100, costs(frame_s=0.0, start_s=0.0, store_bytes_per_s=1e7))
    assert found.seconds == pytest.approx(200 * 10 * 10 * 1e6 / 1e7)
    assert found.bottleneck == "store"


def test_a_worker_gets_no_more_than_its_share():
    found = simulate([10.0], 1, costs(worker_bytes_per_s=1e6))
    assert found.seconds == pytest.approx(100 + 20 + 1)


def test_tables_go_the_same_way():
    found = simulate([10.0], 1, costs(worker_bytes_per_s=1e6, frame_bytes=0.0, result_bytes=1e6))
    assert found.seconds == pytest.approx(100 + 20 + 1)


def test_a_driver_that_is_slow_bounds_the_batch():
    found = simulate([0.1] * 1000, 1000, costs(driver_s=1.0))
    assert found.seconds == pytest.approx(1000 + 1.2)
    assert found.bottleneck == "driver"


def test_a_transfer_shares_with_those_beside_it():
    """100 bytes alone for 2 s at 10 a second, then half of it each until the 40 of the other are through."""
    environment = simpy.Environment()
    link = SharedLink(environment, 10.0, FREE)
    ends = {}

    def transfer(name, begins_s, size):
        yield environment.timeout(begins_s)
        yield link.transfer(size)
        ends[name] = environment.now

    environment.process(transfer("long", 0, 100))
    environment.process(transfer("short", 2, 40))
    environment.run()
    assert ends == {"short": pytest.approx(10), "long": pytest.approx(14)}


@given(lengths, st.integers(1, 40), st.none() | st.floats(1, 100))
def test_no_batch_beats_its_bounds(some, workers, part_s):
    real, split = FleetCosts(store_bytes_per_s=1e8), part_s and FleetSplit(part_s, 5.0)
    found = simulate(some, workers, real, split)
    assert found.seconds >= max(bounds(some, workers, real, split).values()) * (1 - 1e-9)
    assert found.seconds <= simulate(some, 1, real, split).seconds * (1 + 1e-9)
    assert 0 < found.efficiency <= 1 + 1e-9


@given(st.floats(0.1, 1000), st.floats(1, 100))
def test_parts_are_the_whole_and_their_warm_ups(length_s, part_s):
    parts_s = FleetSplit(part_s, 5.0).parts_s(length_s)
    assert max(parts_s) <= part_s + 5
    assert sum(parts_s) - 5.0 * (len(parts_s) - 1) == pytest.approx(length_s)


def test_parts_begin_when_their_log_is_cut():
    """1 s to start and 10 frames a second of 0.1 s: 31 s to cut 30 s of log; then parts of 10, 12 and 12 s at once."""
    found = simulate([30.0], 3, costs(cut_s=0.1), FleetSplit(10.0, 2.0))
    assert found.seconds == pytest.approx(31 + 1 + 2 * 12)
    assert found.bottleneck == "longest log"
    assert simulate([30.0], 1, costs(cut_s=0.1), FleetSplit(10.0, 2.0)).seconds == pytest.approx(31 + 3 + 2 * 34)


def test_a_log_of_one_part_is_not_cut():
    assert simulate([10.0], 1, ALONE, FleetSplit(10.0, 2.0)).seconds == pytest.approx(21)


def test_a_store_gives_a_log_twice_that_is_split():
    found = simulate([30.0], 3, costs(worker_bytes_per_s=1e7, cut_s=0.0), FleetSplit(10.0, 0.0))
    assert found.seconds == pytest.approx(30 + 1 + 10 + 1 + 20)
