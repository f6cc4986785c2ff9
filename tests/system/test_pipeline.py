"""Items through steps: everything in order, whatever is faster; errors where they belong; no thread is left."""

import signal
import threading
import time
from itertools import count

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.system.pipeline import Pipeline

THREADS = (1, 2, 3, 4)
STEPS = ("read", "first", "second", "last")
DELAYS_MS = st.lists(st.tuples(*[st.integers(0, 3)] * len(STEPS)), max_size=8)


class FaultError(Exception):
    pass


class StopError(BaseException):
    """As a signal's KeyboardInterrupt, which no pytest stops for."""


def threads_left():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("roadperc")]


def pause(milliseconds):
    time.sleep(milliseconds / 1000)


def run(threads, delays, broken=()):
    """What each step has made of the items, and the job's error.

    Every step takes so long for each item and adds what it has seen so far: it remembers. ``broken`` are steps that
    fail, by item.
    """
    seen, failed = {step: [] for step in STEPS}, ""

    def work(step, item, before):
        pause(delays[item][STEPS.index(step)])
        if (step, item) in broken:
            raise FaultError(f"{step} {item}")
        seen[step].append((item, *before))
        return item, (*before, len(seen[step]))

    items = (work("read", item, ()) for item in range(len(delays)))
    job = Pipeline(items)
    for step in STEPS[1:]:
        job = job.then(lambda made, step=step: work(step, *made))
    try:
        job.run(threads)
    except FaultError as error:
        failed = str(error)
    return seen, failed


@given(DELAYS_MS, st.sampled_from(THREADS[1:]))
@settings(max_examples=40)
def test_every_step_takes_every_item_once_and_in_order(delays, threads):
    seen, failed = run(threads, delays)
    assert (seen, failed) == run(1, delays)
    assert [item for item, *_ in seen["last"]] == list(range(len(delays)))
    assert threads_left() == []


@given(DELAYS_MS, st.sets(st.tuples(st.sampled_from(STEPS), st.integers(0, 7)), min_size=1))
@settings(max_examples=60)
def test_whatever_fails_the_first_error_is_that_of_one_thread(delays, broken):
    expected, error = run(1, delays, broken)
    for threads in THREADS[1:]:
        seen, failed = run(threads, delays, broken)
        assert failed == error
        assert seen["last"] == expected["last"], "those before it are complete, and none behind it"
    assert threads_left() == []


@pytest.mark.parametrize(("threads", "expected"), [(1, 1), (2, 2), (4, 4), (9, 4)])
def test_as_many_steps_are_at_work_as_there_are_threads(threads, expected):
    together, seen = threading.Barrier(expected), set()

    def meet(step, item):
        """The last steps wait for each other, each at an item of its own: none gets on where they share a thread."""
        if step >= len(STEPS) - expected and item == 10 - step:
            together.wait(timeout=30)
        seen.add(threading.get_ident())
        return item

    job = Pipeline(meet(0, item) for item in range(20))
    for step in range(1, len(STEPS)):
        job = job.then(lambda item, step=step: meet(step, item))
    job.run(threads)
    assert len(seen) == expected


@pytest.mark.parametrize("threads", THREADS)
def test_little_is_under_way(threads):
    under_way, most = set(), []

    def finish(item):
        pause(1)
        under_way.remove(item)

    items = (under_way.add(item) or most.append(len(under_way)) or item for item in range(50))
    Pipeline(items).then(lambda item: item).then(finish).run(threads)
    assert len(most) == 50
    assert max(most) <= (threads + 1 if threads > 1 else 1)


@pytest.mark.parametrize("threads", THREADS)
def test_a_signal_ends_at_once_what_waits(threads):
    """It interrupts the caller's thread, whoever is at what step."""
    done, sent = [], []

    def stop(_number, _frame):
        raise StopError

    def stopped(item):
        pause(1)
        if item == 3 and not sent:  # a second signal would interrupt the end that the first one begins
            sent.append(item)
            signal.raise_signal(signal.SIGALRM)
        return item

    before = signal.signal(signal.SIGALRM, stop)
    try:
        with pytest.raises(StopError):
            Pipeline(count()).then(stopped).then(stopped).then(done.append).run(threads)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert done == list(range(len(done)))
    assert threads_left() == []
    after = len(done)
    pause(20)
    assert len(done) == after


def test_numpy_is_silent_in_every_thread(recwarn):
    with np.errstate(all="ignore"):
        items = (np.float32(1e30) * np.float32(1e30) for _ in range(20))
        Pipeline(items).then(lambda value: (pause(1), np.log(-value))).then(lambda _: np.log(np.float32(-1.0))).run(3)
    assert not recwarn.list
