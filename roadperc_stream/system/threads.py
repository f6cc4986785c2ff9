"""Number of threads of a replay and of the numeric libraries."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TypeVar

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from roadperc_stream.system.pipeline import PATIENCE_S

T = TypeVar("T")
U = TypeVar("U")


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenCV and BLAS to one thread, because a second one mostly waits, and silence numpy's warnings."""
    with opencv_threads(1), threadpool_limits(limits=1, user_api="blas"), np.errstate(all="ignore"):
        yield


@contextmanager
def opencv_threads(number: int) -> Iterator[None]:
    """Set the number of OpenCV's threads in the whole process."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(number)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def usable_cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_order(step: Callable[[T], U], items: Iterable[T], threads: int) -> Iterator[U]:
    """Yield the results of a step for each item, in the items' order.

    Threads prepare a few results in advance, since the libraries release the GIL; one more item than threads is in
    memory. A step that does not return delays Ctrl-C by ``PATIENCE_S``.
    """
    pending: deque[Future[U]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for item in items:
            pending.append(pool.submit(step, item))
            if len(pending) > threads:
                yield pending[0].result()
                pending.popleft()
        while pending:
            yield pending[0].result()
            pending.popleft()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        running = wait([future for future in pending if not future.done()], PATIENCE_S).not_done
        pool.shutdown(wait=not running)
