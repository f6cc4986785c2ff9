"""A few kilobytes that ask for gigabytes: compressed data, images, points."""

import struct
import zlib

import lz4.frame
import zstandard  # noqa: F401 - tests compress with it

_RLE_BYTES = 128 * 1024
_LZ4_BLOCK = 4 * 1024 * 1024


def zstd_zeros(size, *, stated=True):
    """A zstd frame of so many zeros, a multiple of 128 KiB: four bytes for each; its header may leave the size out.

    Format: RFC 8878, blocks of type RLE.
    """
    head = struct.pack("<IB", 0xFD2FB528, 0xC0 if stated else 0x00) + bytes([(27 - 10) << 3])
    head += struct.pack("<Q", size) if stated else b""
    count = size // _RLE_BYTES
    block = struct.pack("<I", _RLE_BYTES << 3 | 1 << 1)[:3] + b"\0"
    last = struct.pack("<I", _RLE_BYTES << 3 | 1 << 1 | 1)[:3] + b"\0"
    return head + block * (count - 1) + last


def lz4_zeros(size):
    """An lz4 frame of so many zeros, a multiple of 4 MiB, without the size in its header."""
    frame = lz4.frame.compress(
        bytes(_LZ4_BLOCK), block_size=lz4.frame.BLOCKSIZE_MAX4MB, block_linked=False, store_size=False
    )
    head, block = frame[:7], frame[7:-4]
    return head + block * (size // _LZ4_BLOCK) + bytes(4)


def png(width, height, *, mode=2, bits=8, extra=b"", rows=None):
    """A PNG whose header says this size, with zeros for so many of its rows (all of them unless said)."""
    channels = {0: 1, 2: 3, 3: 1, 6: 4}[mode]
    row = bytes(1 + (width * channels * bits + 7) // 8)
    packer = zlib.compressobj(9)
    pixels = b"".join(packer.compress(row) for _ in range(height if rows is None else rows)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, bits, mode, 0, 0, 0)
    palette = png_chunk(b"PLTE", bytes(range(48))) if mode == 3 else b""
    content = png_chunk(b"IHDR", header) + extra + palette + png_chunk(b"IDAT", pixels)
    return b"\x89PNG\r\n\x1a\n" + content + png_chunk(b"IEND", b"")


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def jpeg_of_size(jpeg, width, height):
    """The same JPEG with another size in its header."""
    at = jpeg.index(b"\xff\xc0") + 5
    return jpeg[:at] + struct.pack(">HH", height, width) + jpeg[at + 4 :]
