"""The PNG reader gives the same pixels or errors as OpenCV and Pillow."""

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images, png

pytestmark = [
    pytest.mark.skipif(not png.COMPILED, reason="the kernel is not compiled: OpenCV reads every PNG"),
    pytest.mark.filterwarnings("ignore::UserWarning:PIL"),
]

DECODERS = (images.decode_bgr, images.decode_grey, images.decode_grey16, images.decode_indices)
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
BITS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
SIDES = st.integers(1, 9)
PALETTE = (b"PLTE", bytes(range(256)) * 3)
ANCILLARY = (
    (b"pHYs", struct.pack(">IIB", 2835, 1417, 1)),
    (b"pHYs", b""),
    (b"tIME", b"\x07\xea\x0b\x16\x0c\x00\x00"),
    (b"gAMA", struct.pack(">I", 45455)),
    (b"gAMA", struct.pack(">I", 100000)),
    (b"sRGB", b"\x00"),
    (b"sBIT", b"\x05\x06\x05"),
    (b"tRNS", b"\x00\x01\x00\x02\x00\x03"),
    (b"bKGD", b"\x00\x01\x00\x02\x00\x03"),
    (b"tEXt", b"Comment\x00none"),
    (b"eXIf", b"MM\x00*\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00\x00\x00\x00\x00"),
    (b"acTL", struct.pack(">II", 1, 0)),
    (b"prIv", b"anything"),
    (b"CRIT", b"unknown and critical"),
)


def file_of(chunks):
    """A PNG of (name, content) chunks."""
    return png.MAGIC + b"".join(
        struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        for name, content in chunks
    )


def header(width, height, bits, colour_type, methods=(0, 0, 0)):
    return (b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour_type, *methods))


@st.composite
def plain_chunks(draw, kinds=tuple((t, bits) for t in BITS for bits in BITS[t])):
    """Chunks of a PNG of any kind whose lines take any filter."""
    colour_type, bits = draw(st.sampled_from(kinds))
    width, height = draw(SIDES), draw(SIDES)
    lines = draw(arrays(np.uint8, (height, 1 + (width * bits * CHANNELS[colour_type] + 7) // 8)))
    lines[:, 0] = draw(arrays(np.uint8, height, elements=st.integers(0, 4)))
    compressed = zlib.compress(lines.tobytes(), draw(st.integers(0, 9)))
    cut = draw(st.integers(0, len(compressed)))
    content = [(b"IDAT", compressed[:cut]), (b"IDAT", compressed[cut:])]
    return [header(width, height, bits, colour_type), *[PALETTE] * (colour_type == 3), *content, (b"IEND", b"")]


def outcome(decode, data):
    """Return pixels with their type, or the text of the error."""
    try:
        pixels = decode(data)
    except DecodeError as error:
        return str(error)
    return None if pixels is None else (pixels.dtype, pixels.shape, pixels.tobytes(), pixels.flags.writeable)


def assert_same_as_others(data):
    """Compare this reader with OpenCV and Pillow, which read without its kernel."""
    with pytest.MonkeyPatch.context() as patched:
        found = [outcome(decode, data) for decode in DECODERS]
        patched.setattr(png, "COMPILED", False)
        assert found == [outcome(decode, data) for decode in DECODERS]


READ_HERE = {
    png.grey: ((0, 8), (2, 8), (6, 8)),
    png.bgr: ((2, 8), (6, 8)),
    png.grey16: ((0, 16),),
    png.indices: ((0, 8), (3, 8)),
}


@given(st.sampled_from(list(READ_HERE)), st.data())
def test_common_pngs_need_no_other_reader(read, data):
    chunks = data.draw(plain_chunks(READ_HERE[read]))
    pixels = read(file_of(chunks))
    width, height = struct.unpack_from(">II", chunks[0][1])
    assert pixels is not None
    assert pixels.shape[:2] == (height, width)


@given(plain_chunks(), st.lists(st.sampled_from(ANCILLARY), max_size=3), st.randoms(use_true_random=False))
def test_every_kind_and_filter_with_other_chunks(chunks, others, random):
    for other in others:
        chunks.insert(random.randint(0, len(chunks)), other)
    assert_same_as_others(file_of(chunks))


@given(plain_chunks(), st.integers(0, 5), st.integers(0, 5))
def test_missing_repeated_or_reordered_chunks(chunks, one, other):
    chunks = list(chunks)
    chunks[one % len(chunks)] = chunks[other % len(chunks)]
    assert_same_as_others(file_of(chunks))
    assert_same_as_others(file_of([c for c in chunks if c != chunks[one % len(chunks)]]))


@given(plain_chunks(), st.data())
def test_a_changed_byte_anywhere(chunks, data):
    whole = bytearray(file_of(chunks))
    at = data.draw(st.integers(0, len(whole) - 1))
    assume(at not in [len(file_of(chunks[:n])) for n in range(len(chunks))])  # OpenCV allocates any declared length
    whole[at] ^= data.draw(st.integers(1, 255))
    assert_same_as_others(bytes(whole))


@given(plain_chunks(), st.data())
def test_cut_and_extended_files(chunks, data):
    whole = file_of(chunks)
    assert_same_as_others(whole[: data.draw(st.integers(0, len(whole)))])
    assert_same_as_others(whole + data.draw(st.binary(min_size=1, max_size=20)))


@pytest.mark.parametrize("size", [(0, 1), (1, 0), (0, 0), (1 << 14, 1), (1, (1 << 14) + 1), (1 << 31, 1), (9999, 9999)])
def test_a_declared_size_without_pixels(size):
    content = (b"IDAT", zlib.compress(bytes(10)))
    assert_same_as_others(file_of([header(*size, 8, 2), content, (b"IEND", b"")]))


@example(b"")
@example(png.MAGIC)
@given(st.binary(max_size=60))
def test_any_bytes(data):
    assert_same_as_others(data)
    assert_same_as_others(png.MAGIC + data)


def test_an_oversized_stream_takes_no_memory():
    """Megabytes of zeros behind a header of one pixel."""
    compressor = zlib.compressobj(9)
    stream = b"".join(compressor.compress(bytes(1 << 20)) for _ in range(64)) + compressor.flush()
    data = file_of([header(1, 1, 8, 2), (b"IDAT", stream), (b"IEND", b"")])
    tracemalloc.start()
    assert png.bgr(data) is None
    assert tracemalloc.get_traced_memory()[1] < 4 * len(data) + 100_000
    tracemalloc.stop()
