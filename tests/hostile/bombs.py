"""A few kilobytes that ask for gigabytes: compressed data, images."""

import struct
import zlib

import lz4.frame

from tests.fuzz.pictures import png_of

_LZ4_BLOCK = 4 * 1024 * 1024


def lz4_zeros(size):
    """An lz4 frame of so many zeros, a multiple of 4 MiB, without the size in its header."""
    frame = lz4.frame.compress(
        bytes(_LZ4_BLOCK), block_size=lz4.frame.BLOCKSIZE_MAX4MB, block_linked=False, store_size=False
    )
    head, block = frame[:7], frame[7:-4]
    return head + block * (size // _LZ4_BLOCK) + bytes(4)


def png(width, height, *, mode=2, bits=8, extra=(), rows=None):
    """A PNG whose header says this size, with zeros for so many of its rows (all of them unless said).

    ``extra`` are [name, content] of chunks behind the header.
    """
    channels = {0: 1, 2: 3, 3: 1, 6: 4}[mode]
    row = bytes(1 + (width * channels * bits + 7) // 8)
    packer = zlib.compressobj(9)
    pixels = b"".join(packer.compress(row) for _ in range(height if rows is None else rows)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, bits, mode, 0, 0, 0)
    palette = [[b"PLTE", bytes(range(48))]] if mode == 3 else []
    return png_of([[b"IHDR", header], *extra, *palette, [b"IDAT", pixels], [b"IEND", b""]])


def jpeg_of_size(jpeg, width, height):
    """The same JPEG with another size in its header."""
    at = jpeg.index(b"\xff\xc0") + 5
    return jpeg[:at] + struct.pack(">HH", height, width) + jpeg[at + 4 :]
