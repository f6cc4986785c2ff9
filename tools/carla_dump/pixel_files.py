"""Read a frame's file as an array: PNG, JPEG, ``.npy``, EXR, HDF5 or CSV text. The content decides the format.

numpy's reader does not check a ``.npy`` header: it allocates the stated shape, and opens zip archives and pickles.
``read_npy`` compares the header with the size of the file before it allocates an array.
"""

import io
import tokenize
from collections.abc import Iterable
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray
from PIL import Image as PillowImage

from roadperc_stream.model.tag_tables import Colour
from roadperc_stream.system.files import open_file

from .image_files import UnreadableFrameError, read_bytes, read_header, require_whole
from .library_formats import EXR_MAGIC, HDF5_MAGIC, read_exr, read_hdf5

NPY_MAGIC: Final = npy_format.MAGIC_PREFIX
_NUMBERS: Final = "fiu"
_SHOWN_BYTES: Final = 60
_HEADER_READERS: Final = {(1, 0): npy_format.read_array_header_1_0, (2, 0): npy_format.read_array_header_2_0}
"""Version 3 only adds names of fields, and plain numbers have no fields."""
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
"""Errors of a header's text, which numpy gives to Python's parser."""


def read_npy(path: Path, data: bytes) -> NDArray[Any]:
    """Return an array of integers or floats of any shape; allocates at most the size of the file.

    Raises:
        UnreadableFrameError: the file is damaged; the message names file, expected and found content.
    """
    stream = io.BytesIO(data)
    try:
        version = npy_format.read_magic(stream)
        if version not in _HEADER_READERS:
            raise UnreadableFrameError(f"{path}: .npy version {version}, expected (1, 0) or (2, 0)")
        shape, fortran, dtype = _HEADER_READERS[version](stream)
    except _FAULTS as error:
        found = data[:_SHOWN_BYTES]  # the error's text differs between versions of Python and numpy
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
    except (ValueError, OverflowError, MemoryError) as error:  # (10**30, 0) is empty, but larger than any array
        raise UnreadableFrameError(f"{path}: .npy of shape {shape}: {error}") from error


_TEXT: Final = frozenset(b"0123456789.,;+-eEnaif \t\r\n")
_SURVEYED: Final = 3


@dataclass(frozen=True)
class Pixels:
    """(H, W) or (H, W, channels) numbers; colour channels in OpenCV's order blue, green, red, alpha."""

    path: Path
    container: Literal["png", "jpeg", "npy", "exr", "hdf5", "csv"]
    values: NDArray[Any]
    palette: tuple[Colour, ...] = ()
    """Colours of an indexed image; ``values`` holds the indices."""

    @property
    def channels(self) -> int:
        """Return the number of channels, 1 for an (H, W) array."""
        return 1 if self.values.ndim == 2 else int(self.values.shape[2])

    @property
    def size(self) -> tuple[int, int]:
        """Return columns and rows."""
        return int(self.values.shape[1]), int(self.values.shape[0])

    @property
    def shape(self) -> str:
        """Return format, type and shape for messages."""
        return f"{self.container} {self.values.dtype} {'x'.join(map(str, self.values.shape))}"

    def equal_channels(self) -> bool:
        """Return True if red, green and blue are the same everywhere."""
        blue, green, red = (self.values[..., c] for c in range(3))
        return bool(np.array_equal(blue, green) and np.array_equal(green, red))


def load_pixels(path: Path) -> Pixels:
    """Return the numbers of a file.

    Raises:
        UnreadableFrameError: the file is empty, cut off, damaged, or of an unknown format.
        DumpError: the library for the format is not installed.
    """
    data = read_bytes(path)
    if data.startswith(EXR_MAGIC):
        return Pixels(path, "exr", read_exr(path))
    if data.startswith(HDF5_MAGIC):
        return Pixels(path, "hdf5", read_hdf5(path))
    if data.startswith(NPY_MAGIC):
        return _npy(path, data)
    if data and set(data[:256]) <= _TEXT:
        return _csv(path, data)
    return _image(path, data)


def _npy(path: Path, data: bytes) -> Pixels:
    values = read_npy(path, data)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.ndim not in (2, 3) or not values.size:
        raise UnreadableFrameError(f"{path}: .npy of {values.dtype} {values.shape}, expected an image of numbers")
    return Pixels(path, "npy", values)


def _csv(path: Path, data: bytes) -> Pixels:
    delimiter = next((mark for mark in ",;" if mark.encode() in data[:256]), None)
    lines = io.StringIO(data.decode("ascii", "replace"))
    if not data.strip():
        raise UnreadableFrameError(f"{path}: empty file")
    try:
        return Pixels(path, "csv", np.loadtxt(lines, delimiter=delimiter, ndmin=2))
    except ValueError as error:
        raise UnreadableFrameError(f"{path}: not a table of numbers: {error}") from error


def _image(path: Path, data: bytes) -> Pixels:
    container = require_whole(path, data)
    if container == "png" and data[25] == 3:
        return _indexed(path, data)
    try:
        values = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise UnreadableFrameError(f"{path}: damaged {container}: {error.err}") from error
    if values is None:
        raise UnreadableFrameError(f"{path}: damaged {container}")
    return Pixels(path, container, values)


def _indexed(path: Path, data: bytes) -> Pixels:
    """Read an indexed image with Pillow, because OpenCV expands the palette."""
    try:
        with PillowImage.open(io.BytesIO(data), formats=("PNG",)) as image:
            colours = np.array(image.getpalette("RGB") or [], np.uint8).reshape(-1, 3)
            return Pixels(path, "png", np.array(image), tuple((int(r), int(g), int(b)) for r, g, b in colours))
    except (OSError, ValueError, SyntaxError, PillowImage.DecompressionBombError) as error:
        raise UnreadableFrameError(f"{path}: damaged png: {error}") from error


def file_size(path: Path) -> tuple[int, int] | None:
    """Return columns and rows of an image file from its header; None for arrays and tables.

    Raises:
        UnreadableFrameError: the file is empty, cut off, or of an unknown format.
    """
    try:
        with open_file(path) as stream:
            head = stream.read(256)
    except OSError as error:
        raise UnreadableFrameError(f"{path}: {error.strerror or error}") from error
    if head.startswith((NPY_MAGIC, EXR_MAGIC, HDF5_MAGIC)) or (head and set(head) <= _TEXT):
        return None
    return read_header(path)[0]


def surveyed(files: Iterable[Path]) -> list[Pixels]:
    """Return a sample of a sensor's readable files: first, middle and last.

    Raises:
        UnreadableFrameError: no file can be read.
    """
    paths = list(files)
    chosen = sorted({0, len(paths) // 2, len(paths) - 1})
    found, fault = [], None
    for path in [paths[i] for i in chosen] + paths:
        try:
            found.append(load_pixels(path))
        except UnreadableFrameError as error:
            fault = fault or error
        if len(found) == min(_SURVEYED, len(chosen)):
            break
    if not found and fault:
        raise fault
    return found
