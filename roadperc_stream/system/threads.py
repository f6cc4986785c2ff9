"""How many threads the numeric libraries use, and a replay."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from threadpoolctl import threadpool_limits


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV and BLAS to one thread, where a second one mostly waits, and numpy from warning of absurd input."""
    with opencv_threads(1), threadpool_limits(limits=1, user_api="blas"), np.errstate(all="ignore"):
        yield


@contextmanager
def opencv_threads(number: int) -> Iterator[None]:
    """Have OpenCV use so many threads, in the whole process."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(number)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def usable_cores() -> int:
    """The cores that this process may use, which may be fewer than there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
