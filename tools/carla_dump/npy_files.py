"""Arrays of numbers out of ``.npy`` files, whose headers may claim anything.

numpy's own reader believes the header: it allocates what the shape asks for and opens zip archives and pickles by their
first bytes. Here the header is held against the file before an array is made.
"""

import io
import tokenize
from math import prod
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from .image_files import UnreadableFrameError

NPY_MAGIC: Final = npy_format.MAGIC_PREFIX
_NUMBERS: Final = "fiu"
_SHOWN_BYTES: Final = 60
_HEADER_READERS: Final = {
    (1, 0): npy_format.read_array_header_1_0,
    (2, 0): npy_format.read_array_header_2_0,
}
"""Version 3 differs in the names of fields alone, which plain numbers do not have."""
_FAULTS: Final = (
    ValueError,
    TypeError,
    LookupError,
    OverflowError,
    OSError,
    EOFError,
    SyntaxError,
    tokenize.TokenError,
    MemoryError,
    RecursionError,
)
"""What a header's text can raise: numpy has Python's own parser read it."""


def read_npy(path: Path, data: bytes) -> NDArray[Any]:
    """Array of integers or floats of any shape; nothing larger than the file is allocated.

    Raises:
        UnreadableFrameError: names the file, what was expected and what is there.
    """
    stream = io.BytesIO(data)
    try:
        version = npy_format.read_magic(stream)
        if version not in _HEADER_READERS:
            raise UnreadableFrameError(f"{path}: .npy version {version}, expected (1, 0) or (2, 0)")
        shape, fortran, dtype = _HEADER_READERS[version](stream)
    except _FAULTS as error:
        found = data[:_SHOWN_BYTES]  # not the error's text: it differs between versions of Python and numpy
        raise UnreadableFrameError(f"{path}: damaged .npy: expected an array's header, found {found!r}") from error
    if dtype.kind not in _NUMBERS or any(type(side) is not int or side < 0 for side in shape):
        raise UnreadableFrameError(f"{path}: .npy of {dtype} {shape}, expected an array of plain numbers")
    start, size = stream.tell(), prod(shape) * dtype.itemsize
    if size > len(data) - start:
        raise UnreadableFrameError(
            f"{path}: damaged .npy: {len(data) - start} bytes of numbers, expected {size} for {dtype} {shape}"
        )
    try:
        return np.ndarray(shape, dtype, data, start, order="F" if fortran else "C").copy(order="K")
    except (ValueError, OverflowError, MemoryError) as error:  # (10**30, 0): empty, yet beyond any array
        raise UnreadableFrameError(f"{path}: .npy of shape {shape}: {error}") from error
