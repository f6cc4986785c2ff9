"""Items ahead, tasks behind: everything in order, whatever is faster; errors where they belong; no thread is left."""

import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.core.pipeline import Pipeline

THREADS = (1, 2, 3, 4)
DELAYS_MS = st.lists(st.tuples(*[st.integers(0, 3)] * 3), max_size=8)


class FaultError(Exception):
    pass


def threads_left():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("roadperc")]


def pause(milliseconds):
    time.sleep(milliseconds / 1000)


def fail_at(broken, step, item):
    if (step, item) in broken:
        raise FaultError(f"{step} {item}")


def run(threads, delays=((0, 0, 0),) * 8, broken=()):
    """What happened in a job whose steps take so long each, and its error; ``broken`` are steps that fail, by item."""
    done, failed = [], ""

    def made():
        for item, (slow, _, _) in enumerate(delays):
            pause(slow)
            fail_at(broken, "ahead", item)
            yield item, slow

    def finish(item, slow):
        pause(slow)
        fail_at(broken, "behind", item)
        done.append(item)

    try:
        with Pipeline(threads) as pipeline:
            for item, _ in pipeline.ahead(made()):
                pause(delays[item][1])
                fail_at(broken, "caller", item)
                pipeline.behind(lambda item=item: finish(item, delays[item][2]))
    except FaultError as error:
        failed = str(error)
    return done, failed


@given(DELAYS_MS, st.sampled_from(THREADS))
@settings(max_examples=40, deadline=None)
def test_every_item_is_done_once_and_in_order(delays, threads):
    assert run(threads, delays) == (list(range(len(delays))), "")
    assert threads_left() == []


@given(DELAYS_MS, st.sets(st.tuples(st.sampled_from(("ahead", "caller", "behind")), st.integers(0, 7)), min_size=1))
@settings(max_examples=60, deadline=None)
def test_whatever_fails_the_first_error_is_that_of_one_thread(delays, broken):
    for threads in THREADS[1:]:
        assert run(threads, delays, broken) == run(1, delays, broken)
    assert threads_left() == []


@pytest.mark.parametrize(("threads", "expected"), [(1, 1), (2, 2), (3, 3), (8, 3)])
def test_it_works_in_as_many_threads_as_it_is_told(threads, expected):
    seen = {threading.get_ident()}
    with Pipeline(threads) as pipeline:
        for _ in pipeline.ahead(seen.add(threading.get_ident()) for _ in range(4)):
            pipeline.behind(lambda: seen.add(threading.get_ident()))
    assert len(seen) == expected


def test_little_is_made_ahead_and_little_is_left_behind():
    made, release = [], threading.Event()
    with Pipeline(3) as pipeline:
        items = pipeline.ahead(made.append(k) or k for k in range(100))
        assert next(items) == 0
        pause(50)
        assert len(made) <= 4
        waits = threading.Thread(target=lambda: [pipeline.behind(release.wait) for _ in range(10)])
        waits.start()
        pause(50)
        assert waits.is_alive(), "who hands over more than is done waits"
        release.set()
        waits.join()


class StopError(BaseException):
    """As a signal's KeyboardInterrupt, which no pytest stops for."""


@pytest.mark.parametrize("threads", THREADS)
def test_a_signal_ends_at_once_what_waits(threads):
    done = []

    def stopped():
        with Pipeline(threads) as pipeline:
            for item in pipeline.ahead(iter(range(100))):
                pipeline.behind(lambda item=item: (pause(5), done.append(item)))
                if item == 3:
                    raise StopError

    with pytest.raises(StopError):
        stopped()
    assert len(done) <= 4
    assert threads_left() == []


def test_numpy_is_silent_in_every_thread(recwarn):
    with Pipeline(3) as pipeline, np.errstate(all="ignore"):
        for value in pipeline.ahead(np.float32(1e30) * np.float32(1e30) for _ in range(2)):
            pipeline.behind(lambda value=value: np.log(-value))
    assert not recwarn.list
