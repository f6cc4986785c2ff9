"""Masks as PNG files of one bit a pixel.

Written here: Pillow packs the bits of a palette image pixel by pixel, which takes six times as long as all the rest.
Source: Portable Network Graphics (PNG) Specification, third edition, 4.5 to 11.2.
"""

import struct
import zlib
from typing import Final

import numpy as np

from roadperc_stream.core.datatypes import Mask
from roadperc_stream.core.semantics import Colour
from roadperc_stream.formats.images import PNG_MAGIC

_HEADER: Final = struct.Struct(">IIBBBBB")
"""Columns, rows, bits, kind of colours, and the one way there is to compress, to filter, to interlace."""
_PALETTE_OF_BITS: Final = (1, 3)


def encode_mask(mask: Mask, colours: tuple[Colour, Colour]) -> bytes:
    """Palette PNG of an (H, W) mask: index 0 where it is False, 1 where it is True."""
    rows, columns = mask.shape
    header = _HEADER.pack(columns, rows, *_PALETTE_OF_BITS, 0, 0, 0)
    scanlines = np.pad(np.packbits(mask, axis=1), ((0, 0), (1, 0)))  # each begins with 0: it is not filtered
    deflate = zlib.compressobj(strategy=zlib.Z_RLE)  # runs are all that a mask has, and all this looks for
    data = deflate.compress(scanlines.tobytes()) + deflate.flush()
    chunks = {b"IHDR": header, b"PLTE": bytes(np.array(colours, np.uint8)), b"IDAT": data, b"IEND": b""}
    return PNG_MAGIC + b"".join(_chunk(kind, content) for kind, content in chunks.items())


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
