"""Reads common PNGs faster than OpenCV with the same pixels, and writes masks as PNGs.

libdeflate inflates a file, and a compiled kernel reverses its filters. They return None for an unusual or damaged
file, and for every file if the kernel is not compiled. OpenCV or Pillow then decodes the file or reports its fault.

Masks are written with one bit a pixel. Pillow packs these bits pixel by pixel and takes six times as long.
Source: Portable Network Graphics (PNG) Specification, third edition, 4.5 to 11.2.
"""

import struct
import zlib
from dataclasses import dataclass
from typing import Final

import deflate
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.kernels import COMPILED
from roadperc_stream.model import Image, Mask
from roadperc_stream.model.tag_tables import Colour

if COMPILED:
    from roadperc_stream.kernels import reverse_filters, reverse_to_grey

MAGIC: Final = b"\x89PNG\r\n\x1a\n"
_CHUNK: Final = struct.Struct(">I4s")
_CRC: Final = struct.Struct(">I")
_HEADER: Final = struct.Struct(">IIBBBBB")
"""Columns, rows, bits, colour type, and the methods of compression, filtering and interlacing."""
_PIXEL_SIZE: Final = b"pHYs"
"""The one ancillary chunk that recorders such as ffmpeg write; it does not affect the pixels."""
_PIXEL_SIZE_BYTES: Final = 9
_PALETTE_BYTES: Final = range(3, 3 * 256 + 1, 3)
_LONGEST_SIDE: Final = 1 << 14
"""OpenCV refuses some larger sizes, so it decodes all of them."""
_HISTORY: Final = 1 << 15
"""The largest distance of a deflate match, in bytes."""
GREY, COLOURS, PALETTE, COLOURS_ALPHA = 0, 2, 3, 6
_CHANNELS: Final = {GREY: 1, COLOURS: 3, PALETTE: 1, COLOURS_ALPHA: 4}


@dataclass(frozen=True)
class _Lines:
    """A PNG's inflated lines and its pixel format, with 8 or 16 bits a number."""

    width: int
    bits: int
    colour_type: int
    filtered: NDArray[np.uint8]
    """(H, 1 + L): each line's filter type and its L bytes."""

    @property
    def pixel_bytes(self) -> int:
        """Bytes a pixel: the distance that filters look back."""
        return self.bits * _CHANNELS[self.colour_type] // 8

    def rows(self) -> NDArray[np.uint8] | None:
        """(H, L) bytes, unfiltered in place; None for an unknown filter."""
        return self.filtered[:, 1:] if reverse_filters(self.filtered, self.pixel_bytes) else None

    def one_byte_pixels(self) -> Image | None:
        """A copy of the (H, W) uint8 pixels; None for an unknown filter."""
        rows = self.rows()
        return None if rows is None else np.ascontiguousarray(rows)


def grey(data: bytes) -> Image | None:
    """(H, W) uint8 of a grey or colour PNG, as OpenCV's ``IMREAD_GRAYSCALE`` gives it."""
    lines = _lines_of(data, {(GREY, 8), (COLOURS, 8), (COLOURS_ALPHA, 8)})
    if lines is None:
        return None
    if lines.colour_type == GREY:
        return lines.one_byte_pixels()
    pixels = np.empty((len(lines.filtered), lines.width), np.uint8)
    return pixels if reverse_to_grey(lines.filtered, lines.pixel_bytes, pixels) else None


def bgr(data: bytes) -> Image | None:
    """(H, W, 3) uint8 of a colour PNG, as OpenCV's ``IMREAD_COLOR`` gives it."""
    lines = _lines_of(data, {(COLOURS, 8), (COLOURS_ALPHA, 8)})
    if lines is None or (rows := lines.rows()) is None:
        return None
    import cv2

    order = cv2.COLOR_RGB2BGR if lines.colour_type == COLOURS else cv2.COLOR_RGBA2BGR
    return cv2.cvtColor(rows.reshape(len(rows), lines.width, -1), order).astype(np.uint8, copy=False)


def grey16(data: bytes) -> NDArray[np.uint16] | None:
    """(H, W) uint16 of a 16-bit grey PNG, as OpenCV's ``IMREAD_UNCHANGED`` gives it."""
    lines = _lines_of(data, {(GREY, 16)})
    if lines is None or (rows := lines.rows()) is None:
        return None
    return rows.view(">u2").astype(np.uint16)


def indices(data: bytes) -> Image | None:
    """(H, W) uint8 indices of an 8-bit palette PNG, or the values of an 8-bit grey one."""
    lines = _lines_of(data, {(GREY, 8), (PALETTE, 8)})
    return None if lines is None else lines.one_byte_pixels()


def _lines_of(data: bytes, kinds: set[tuple[int, int]]) -> _Lines | None:
    """The lines of a whole PNG whose (colour type, bits) is among ``kinds``; None for any other."""
    chunks = _chunks(data) if COMPILED else None
    if chunks is None:
        return None
    width, height, bits, colour_type, *methods = _HEADER.unpack(chunks[0][1])
    if any(methods) or (colour_type, bits) not in kinds or not _in_order(chunks, colour_type):
        return None
    if not (0 < width <= _LONGEST_SIDE and 0 < height <= _LONGEST_SIDE):
        return None
    row_bytes = width * bits * _CHANNELS[colour_type] // 8
    parts = [content for name, content in chunks if name == b"IDAT"]
    filtered = _inflated(parts[0] if len(parts) == 1 else b"".join(parts), height * (1 + row_bytes))
    if filtered is None:
        return None
    return _Lines(width, bits, colour_type, np.frombuffer(filtered, np.uint8).reshape(height, 1 + row_bytes))


def _in_order(chunks: list[tuple[bytes, memoryview]], colour_type: int) -> bool:
    """Whether the PNG has exactly the required chunks in order; there may be several ``IDAT``."""
    names = [name for name, _ in chunks]
    palette = [b"PLTE"] * (colour_type == PALETTE)
    in_size = all(len(content) in _PALETTE_BYTES for name, content in chunks if name == b"PLTE")
    return in_size and names == [b"IHDR", *palette, *[b"IDAT"] * names.count(b"IDAT"), b"IEND"]


def _chunks(data: bytes) -> list[tuple[bytes, memoryview]] | None:
    """Name and content of each chunk except ``pHYs``; None if one is damaged."""
    if not data.startswith(MAGIC):
        return None
    chunks: list[tuple[bytes, memoryview]] = []
    view, at = memoryview(data), len(MAGIC)
    while at + _CHUNK.size + _CRC.size <= len(data):
        length, name = _CHUNK.unpack_from(data, at)
        end = at + _CHUNK.size + length
        if end + _CRC.size > len(data) or _CRC.unpack_from(data, end)[0] != deflate.crc32(view[at + 4 : end]):
            return None
        if not (name == _PIXEL_SIZE and length == _PIXEL_SIZE_BYTES and len(chunks) == 1):
            chunks.append((name, view[at + _CHUNK.size : end]))
        at = end + _CRC.size
    return chunks if at == len(data) and chunks and len(chunks[0][1]) == _HEADER.size else None


def _inflated(compressed: bytes | memoryview, size: int) -> bytearray | None:
    """The ``size`` bytes that the header implies; None if the stream gives more or fewer."""
    if not compressed or min(size, _HISTORY) > 1 << (8 + (compressed[0] >> 4)):
        return None  # libdeflate accepts matches beyond the declared window, zlib refuses them
    try:
        inflated = deflate.zlib_decompress(compressed, size)
    except deflate.DeflateError:
        return None
    return inflated if len(inflated) == size else None


def encode_mask(mask: Mask, colours: tuple[Colour, Colour]) -> bytes:
    """Palette PNG of an (H, W) mask: index 0 for False, 1 for True."""
    rows, columns = mask.shape
    header = _HEADER.pack(columns, rows, 1, PALETTE, 0, 0, 0)
    bits = np.packbits(mask, axis=1)
    scanlines = np.zeros((rows, 1 + bits.shape[1]), np.uint8)  # filter type 0: none
    scanlines[:, 1:] = bits
    runs = zlib.compressobj(strategy=zlib.Z_RLE)  # masks consist of runs
    data = runs.compress(scanlines.data) + runs.flush()
    chunks = {b"IHDR": header, b"PLTE": bytes(np.array(colours, np.uint8)), b"IDAT": data, b"IEND": b""}
    return MAGIC + b"".join(_chunk_of(kind, content) for kind, content in chunks.items())


def _chunk_of(kind: bytes, content: bytes) -> bytes:
    return _CHUNK.pack(len(content), kind) + content + _CRC.pack(zlib.crc32(kind + content))
