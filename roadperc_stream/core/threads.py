"""How many threads the numeric libraries use."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from threadpoolctl import threadpool_limits


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV and BLAS to one thread, where a second one mostly waits, and numpy from warning of absurd input."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(limits=1, user_api="blas"), np.errstate(all="ignore"):
            yield
    finally:
        cv2.setNumThreads(before)
