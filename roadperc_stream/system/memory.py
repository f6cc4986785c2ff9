"""How the C library deals with memory that arrays give back."""

import ctypes
from typing import Final

_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
"""Parameters of glibc's ``mallopt``, as its malloc.h numbers them."""
_LARGEST_KEPT: Final = 32 << 20
"""Bytes of an array up to which it is taken from memory that is kept: the most that glibc accepts."""
_KEPT: Final = 256 << 20
"""Bytes that are kept free at the end of the heap before any are given back."""


def keep_freed_memory() -> None:
    """Let the C library keep freed memory for the arrays of the next frame; for a process that replays and ends.

    Every frame needs the same few hundred arrays. By its defaults glibc gives the large ones' pages back to the system
    and asks for them again, thousands a frame, each of which the system must clear first. No more memory is used at
    once. Other C libraries have no such setting, and nothing is done.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST_KEPT)
        mallopt(_TRIM_THRESHOLD, _KEPT)
