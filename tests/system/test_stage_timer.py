"""The parts of a frame's time, by clocks that only the test moves."""

from time import thread_time

import pytest

from roadperc_stream.system.progress import StageTimer


class Clock:
    """Seconds."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s

    def work(self, milliseconds):
        self.now_s += milliseconds / 1000


def test_a_part_that_comes_again_counts_twice_and_the_total_has_what_no_part_measures():
    clock = Clock()
    timer = StageTimer(clock)
    clock.work(4)
    for name, milliseconds in (("read", 2), ("surface", 5), ("lanes", 7), ("surface", 1)):
        with timer(name):
            clock.work(milliseconds)
    timer.end()
    assert timer.columns() == pytest.approx({"read_ms": 2, "surface_ms": 6, "lanes_ms": 7, "total_ms": 19})


def test_a_part_that_fails_is_measured_too():
    clock = Clock()
    timer = StageTimer(clock)

    def failing():
        with timer("lanes"):
            clock.work(3)
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        failing()
    assert timer.columns() == pytest.approx({"lanes_ms": 3})


def test_of_the_clocks_of_several_threads_the_total_is_the_sum():
    timer = StageTimer(thread_time)
    timer.elapsed_ms |= {"read": 2.0, "lanes": 40.0}
    timer.end()
    assert timer.columns() == {"read_ms": 2.0, "lanes_ms": 40.0, "total_ms": 42.0}
