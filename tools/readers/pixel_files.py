"""Read a frame's file as an array: PNG, JPEG, ``.npy``, EXR, HDF5 or CSV text. The content decides the format.

Raises everywhere:
    UnreadableFrameError: the file is empty, cut off, damaged, or of an unknown format; the message names it.
    DumpError: the library for the format is not installed.
"""

import io
import tokenize
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from roadperc_stream.model.tag_tables import Colour

from .image_files import UnreadableFrameError, first_bytes, read_bytes, read_header, require_whole
from .library_formats import EXR_MAGIC, HDF5_MAGIC, read_exr, read_hdf5

NPY_MAGIC: Final = b"\x93NUMPY"
_TEXT: Final = frozenset(b"0123456789.,;+-eEnaif \t\r\n")
_HEAD_BYTES: Final = 256
_SAMPLES: Final = 3
_NPY_FAULTS: Final = (
    ValueError,
    TypeError,
    LookupError,
    EOFError,
    MemoryError,
    OverflowError,
    RecursionError,
    SyntaxError,
    tokenize.TokenError,
)
"""Errors of ``np.load``, which gives the text of a header to Python's parser."""


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
    """Return the numbers of a file."""
    data = read_bytes(path)
    if data.startswith(EXR_MAGIC):
        return Pixels(path, "exr", read_exr(path))
    if data.startswith(HDF5_MAGIC):
        return Pixels(path, "hdf5", read_hdf5(path))
    if data.startswith(NPY_MAGIC):
        return _npy(path, data)
    if _is_text(data):
        return _csv(path, data)
    return _image(path, data)


def file_size(path: Path) -> tuple[int, int] | None:
    """Return columns and rows of an image file from its header; None for arrays and tables."""
    head = first_bytes(path, _HEAD_BYTES)
    is_array = head.startswith((NPY_MAGIC, EXR_MAGIC, HDF5_MAGIC)) or _is_text(head)
    return None if is_array else read_header(path)[0]


def samples_of(files: Iterable[Path]) -> list[Pixels]:
    """Return a sample of a sensor's readable files: first, middle and last.

    It is an error if no file can be read.
    """
    paths = list(files)
    chosen = sorted({0, len(paths) // 2, len(paths) - 1})
    found, fault = [], None
    for path in [paths[i] for i in chosen] + paths:
        try:
            found.append(load_pixels(path))
        except UnreadableFrameError as error:
            fault = fault or error
        if len(found) == min(_SAMPLES, len(chosen)):
            break
    if not found and fault:
        raise fault
    return found


def read_npy(path: Path, data: bytes) -> NDArray[Any]:
    """Return an array of integers or floats of any shape."""
    try:
        values: NDArray[Any] = np.load(io.BytesIO(data), allow_pickle=False)
    except _NPY_FAULTS as error:
        raise UnreadableFrameError(f"{path}: damaged .npy: {' '.join(str(error).split())}") from error
    if values.dtype.kind not in "fiu":
        raise UnreadableFrameError(f"{path}: .npy of {values.dtype} {values.shape}, expected an array of plain numbers")
    return values


def _is_text(data: bytes) -> bool:
    return bool(data) and set(data[:_HEAD_BYTES]) <= _TEXT


def _npy(path: Path, data: bytes) -> Pixels:
    values = read_npy(path, data)
    if values.ndim == 3 and values.shape[2] == 1:
        values = values[..., 0]
    if values.ndim not in (2, 3) or not values.size:
        raise UnreadableFrameError(f"{path}: .npy of {values.dtype} {values.shape}, expected an image of numbers")
    return Pixels(path, "npy", values)


def _csv(path: Path, data: bytes) -> Pixels:
    delimiter = next((mark for mark in ",;" if mark.encode() in data[:_HEAD_BYTES]), None)
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
