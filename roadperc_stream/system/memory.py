"""Settings of the C library for freed memory."""

import ctypes
from typing import Final

_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
"""Parameters of glibc's ``mallopt``, from malloc.h."""
_LARGEST_KEPT: Final = 32 << 20
"""Arrays up to this many bytes use kept memory; the largest value that glibc accepts."""
_KEPT: Final = 256 << 20
"""Free bytes at the end of the heap that glibc does not return to the system."""


def keep_freed_memory() -> None:
    """Make the C library keep freed memory for the arrays of the next frame; for a process that replays and ends.

    Every frame needs the same few hundred arrays. By default glibc returns the pages of large arrays to the system and
    requests them again: thousands per frame, which the system must clear. The peak memory does not change. Other C
    libraries have no such setting; the function then does nothing.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST_KEPT)
        mallopt(_TRIM_THRESHOLD, _KEPT)
