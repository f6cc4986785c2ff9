"""PNG files taken apart: what inflating costs, and what decoding costs without it.

Source: Portable Network Graphics (PNG) Specification, third edition, W3C; RFC 1950 and 1951.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import Final

from roadperc_stream.formats.images import PNG_MAGIC

_LENGTH: Final = struct.Struct(">I")
_PIXELS: Final = b"IDAT"


def chunks(png: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Type and content of each chunk."""
    at = len(PNG_MAGIC)
    while at < len(png):
        (length,) = _LENGTH.unpack_from(png, at)
        yield png[at + 4 : at + 8], png[at + 8 : at + 8 + length]
        at += length + 12


def pixel_stream(png: bytes) -> bytes:
    """The compressed stream that holds the filtered pixels."""
    return b"".join(content for kind, content in chunks(png) if kind == _PIXELS)


def stored(png: bytes) -> bytes:
    """The same image with the same filters, whose pixels are not compressed."""
    pixels = zlib.compress(zlib.decompress(pixel_stream(png)), 0)
    written, made = False, [PNG_MAGIC]
    for kind, content in chunks(png):
        if kind != _PIXELS:
            made.append(_chunk(kind, content))
        elif not written:
            made.append(_chunk(kind, pixels))
            written = True
    return b"".join(made)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return b"".join((_LENGTH.pack(len(content)), kind, content, _LENGTH.pack(zlib.crc32(kind + content))))
