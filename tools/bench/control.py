"""Fixed work: how much its time varies is how much the machine's noise makes of any other time."""

import zlib
from time import process_time
from typing import Final

import cv2
import numpy as np

_REPEATS: Final = 8
_SIDE: Final = 512


def measure() -> float:
    """Milliseconds of a processor that the work takes: packing, filtering and plain Python, a quarter of a second."""
    pixels = np.random.default_rng(0).integers(0, 32, (_SIDE, _SIDE), np.uint8)
    started = process_time()
    for _ in range(_REPEATS):
        zlib.compress(cv2.GaussianBlur(pixels, (9, 9), 2.0).tobytes(), 6)
        sum(index * index for index in range(100_000))
    return (process_time() - started) * 1000
