"""Encodes states: a magic number, the format version, a CRC-32, and MessagePack compressed with Zstandard.

A dataclass becomes a map by field name, an array a map of ``dtype``, ``shape`` and ``elements`` (little-endian,
C order), so floats keep all their bits. Decoding checks the CRC, the size and every type, and never runs code.
"""

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any, Final, TypeVar, get_args

import msgspec
import numpy as np
import zstandard
from numpy.typing import NDArray

from roadperc_stream.errors import StateError

FORMAT_VERSION: Final = 14
"""Raise it with every change to the contents of a state; otherwise an older state would be misread."""
MOST_BYTES: Final = 256 * 1024**2
"""Limit on the size of an uncompressed state; the state of a long log with large images has some megabytes."""
_MAGIC: Final = b"RPSTATE"
_CRC: Final = struct.Struct("<I")
_HEADER_BYTES: Final = len(_MAGIC) + 1 + _CRC.size
_DTYPES: Final = frozenset({"|b1", "|u1", "<u2", "<i4", "<i8", "<f4", "<f8"})
_LEVEL: Final = 3
T = TypeVar("T")


@dataclass(frozen=True)
class _EncodedArray:
    dtype: str
    shape: tuple[int, ...]
    elements: memoryview


def encode(state: Any) -> bytes:
    """The bytes of a dataclass and its contents. Equal values give equal bytes.

    Raises:
        StateError: it is too large.
    """
    plain = encode_plain(state, MOST_BYTES)
    packed = zstandard.ZstdCompressor(level=_LEVEL).compress(plain)
    return _MAGIC + bytes([FORMAT_VERSION]) + _CRC.pack(zlib.crc32(packed)) + packed


def decode(data: bytes, kind: type[T]) -> T:
    """The dataclass that the bytes encode.

    Raises:
        StateError: the bytes have another format or version, were changed, or are too many.
    """
    packed = data[_HEADER_BYTES:]
    if data[: len(_MAGIC)] != _MAGIC or len(data) <= len(_MAGIC):
        raise StateError("not the state of a replay")
    if data[len(_MAGIC)] != FORMAT_VERSION:
        raise StateError(f"its format has version {data[len(_MAGIC)]}, expected {FORMAT_VERSION}")
    if data[len(_MAGIC) + 1 : _HEADER_BYTES] != _CRC.pack(zlib.crc32(packed)):
        raise StateError("damaged: its CRC is wrong")
    try:
        return decode_plain(_unpacked(packed), kind)
    except (ValueError, RecursionError, OverflowError) as error:
        raise StateError(f"damaged: {error}") from error


def encode_plain(value: Any, most_bytes: int) -> bytes:
    """The MessagePack of a dataclass; ``StateError`` if it is too large, ``TypeError`` if a value has no encoding."""
    try:
        plain = msgspec.msgpack.encode(value, enc_hook=_encoded)
    except RecursionError as error:
        raise StateError("nested too deeply") from error
    if len(plain) > most_bytes:
        raise StateError(f"{len(plain)} bytes: expected {most_bytes} at most")
    return plain


def decode_plain(plain: bytes, kind: type[T]) -> T:
    """The dataclass that MessagePack encodes; errors as in ``decode``, or of the dataclass itself."""
    found: T = msgspec.msgpack.decode(plain, type=kind, dec_hook=_decoded)
    return found


def _unpacked(packed: bytes) -> bytes:
    try:
        with zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(packed) as reader:
            plain: bytes = reader.read(MOST_BYTES + 1)
    except zstandard.ZstdError as error:
        raise StateError(f"damaged: {error}") from error
    if len(plain) > MOST_BYTES:
        raise StateError(f"more than {MOST_BYTES} bytes: expected {MOST_BYTES} at most")
    return plain


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _EncodedArray(value.dtype.str, value.shape, np.ascontiguousarray(value).data)
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} has no encoding")


def _decoded(kind: Any, value: Any) -> NDArray[Any]:
    array = msgspec.convert(value, _EncodedArray)
    if array.dtype not in _DTYPES or any(length < 0 for length in array.shape):
        raise ValueError(f"array of dtype {array.dtype!r} and shape {array.shape}")
    dtype = np.dtype(array.dtype)
    expected = [item for part in get_args(kind)[1:] for item in get_args(part) if item is not Any]
    if expected and np.dtype(expected[0]) != dtype:
        raise ValueError(f"array of dtype {array.dtype!r}, expected {np.dtype(expected[0]).str!r}")
    if math.prod(array.shape) * dtype.itemsize != len(array.elements):
        raise ValueError(f"array of shape {array.shape} and dtype {array.dtype!r} in {len(array.elements)} bytes")
    found = np.frombuffer(array.elements, dtype).reshape(array.shape).copy()
    found.setflags(write=False)
    return found
