"""Checks the size of an AVIF's coded frames, because decoders ignore the size in its container.

Sources: ISO/IEC 14496-12 (boxes, ``iloc``); AV1 Bitstream & Decoding Process Specification, 5.3 to 5.5.
"""

import re
import struct
from collections.abc import Iterator
from typing import Final

from roadperc_stream.errors import DecodeError

_ITEMS: Final = re.compile(rb"iloc\0\0\0\0\x44\0\0[\1\2]")
"""The head of an ``iloc`` box, version 0 with 32 bits. Entries: item, file, number of extents, offset, length."""


def require_frames_of(data: bytes, size: tuple[int, int]) -> None:
    """Require a still picture in libavif's layout, whose frames all have the container's size.

    Raises:
        DecodeError: another size or layout.
    """
    try:
        found = set(_frame_sizes(data))
    except (IndexError, ValueError, struct.error):
        found = set()
    if found != {size}:
        frames = ", ".join(f"{width}x{height}" for width, height in sorted(found)) or "unknown size"
        raise DecodeError(f"AVIF of {size[0]}x{size[1]} with frames of {frames}: expected a still picture; convert it")


def _frame_sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Columns and rows in each sequence header (OBU type 1) of each item."""
    (meta_at,) = struct.unpack_from(">I", data)
    meta_bytes, meta_name = struct.unpack_from(">I4s", data, meta_at)
    mdat_bytes, mdat_name = struct.unpack_from(">I4s", data, meta_at + meta_bytes)
    meta = data[meta_at : meta_at + meta_bytes]
    items = _ITEMS.search(meta)
    names, end = (meta_name, mdat_name), meta_at + meta_bytes + mdat_bytes
    if items is None or meta.count(b"iloc") > 1 or names != (b"meta", b"mdat") or end != len(data):
        raise ValueError("another layout")
    for *_, extents, offset, length in struct.iter_unpack(">HHHII", meta[items.end() :][: 14 * items[0][-1]]):
        at, end = offset, offset + length
        if extents != 1:
            raise ValueError("an item in pieces")
        while at < end:
            kind, flags, size, shift, more = data[at] >> 3, data[at] & 0x87, 0, 0, True
            while more:
                at += 1
                size, shift, more = size | (data[at] & 0x7F) << shift, shift + 7, data[at] > 0x7F
            if flags != 2:
                raise ValueError("an OBU without a size")
            if kind == 1:
                yield _size_of("".join(f"{byte:08b}" for byte in data[at + 1 : at + 9]))
            at += 1 + size


def _size_of(bits: str) -> tuple[int, int]:
    """Columns and rows in a still picture's sequence header.

    Bit 4 excludes frames with other sizes. Two lengths in bits and two sizes follow.
    """
    columns, rows = int(bits[10:14], 2) + 1, int(bits[14:18], 2) + 1
    if bits[4] == "0":
        raise ValueError("frames may have sizes of their own")
    return int(bits[18 : 18 + columns], 2) + 1, int(bits[18 + columns : 18 + columns + rows], 2) + 1
