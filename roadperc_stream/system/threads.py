"""Number of threads of a replay and of the numeric libraries."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from threadpoolctl import threadpool_limits


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
