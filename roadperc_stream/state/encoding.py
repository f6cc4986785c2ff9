"""States as bytes: MessagePack, compressed with Zstandard, behind a magic number with the format's version.

Every dataclass is a map by its fields' names, every array one of ``dtype``, ``shape`` and ``data``, its numbers little
endian in the order of C: floats keep all their bits. Nothing is decoded whose type is not the one expected, and no type
is code.
"""

import math
from dataclasses import dataclass
from typing import Any, Final, TypeVar, get_args

import msgspec
import numpy as np
import zstandard
from numpy.typing import NDArray

from roadperc_stream.errors import StateError

FORMAT_VERSION: Final = 1
"""To be raised with every change of what a state holds: an older state would be taken for something else."""
MOST_BYTES: Final = 512 * 1024**2
"""Of a state, unpacked."""
_MAGIC: Final = b"RPSTATE"
_DTYPES: Final = frozenset({"|b1", "|u1", "<u2", "<i4", "<i8", "<f4", "<f8"})
_LEVEL: Final = 3
T = TypeVar("T")


@dataclass(frozen=True)
class _EncodedArray:
    dtype: str
    shape: tuple[int, ...]
    data: bytes


def encode(state: Any) -> bytes:
    """The bytes of a dataclass and all that it holds; equal things give equal bytes.

    Raises:
        StateError: it is too large.
    """
    plain = msgspec.msgpack.encode(state, enc_hook=_encoded)
    if len(plain) > MOST_BYTES:
        raise StateError(f"{len(plain)} bytes, at most {MOST_BYTES} are written")
    return _MAGIC + bytes([FORMAT_VERSION]) + zstandard.ZstdCompressor(level=_LEVEL).compress(plain)


def decode(data: bytes, kind: type[T]) -> T:
    """A dataclass of its bytes.

    Args:
        data: from ``encode``, or from anybody.
        kind: the dataclass.

    Raises:
        StateError: the bytes are of another version of the format, or of anything else.
    """
    header = len(_MAGIC) + 1
    if data[: len(_MAGIC)] != _MAGIC or len(data) < header:
        raise StateError("is no state of a replay")
    if data[len(_MAGIC)] != FORMAT_VERSION:
        raise StateError(f"its format has version {data[len(_MAGIC)]}, expected {FORMAT_VERSION}")
    try:
        found: T = msgspec.msgpack.decode(_unpacked(data[header:]), type=kind, dec_hook=_decoded)
    except (ValueError, zstandard.ZstdError, RecursionError, OverflowError) as error:
        raise StateError(f"damaged: {error}") from error
    return found


def _unpacked(packed: bytes) -> bytes:
    with zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(packed) as reader:
        plain: bytes = reader.read(MOST_BYTES + 1)
    if len(plain) > MOST_BYTES:
        raise StateError(f"more than {MOST_BYTES} bytes, at most that many are read")
    return plain


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return _EncodedArray(value.dtype.str, value.shape, value.tobytes())
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
    if math.prod(array.shape) * dtype.itemsize != len(array.data):
        raise ValueError(f"array of shape {array.shape} and dtype {array.dtype!r} in {len(array.data)} bytes")
    found = np.frombuffer(array.data, dtype).reshape(array.shape).copy()
    found.setflags(write=False)
    return found
