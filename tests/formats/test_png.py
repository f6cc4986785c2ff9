"""The PNG reader gives the same pixels or errors as OpenCV and Pillow."""

import io
import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image as PillowImage

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


@given(
    chunks=plain_chunks(tuple((3, bits) for bits in BITS[3])),
    size=st.sampled_from((0, 1, 3, 4, 6, 765, 767, 768, 769, 771, 10_000)),
)
def test_palettes_of_any_size(chunks, size):
    palette = (b"PLTE", bytes(k % 256 for k in range(size)))
    assert_same_as_others(file_of([palette if chunk == PALETTE else chunk for chunk in chunks]))


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
def test_a_changed_byte_with_a_correct_crc(chunks, data):
    at = data.draw(st.integers(0, len(chunks) - 1))
    name, content = chunks[at]
    assume(content and name != b"PLTE")
    changed = bytearray(content)
    changed[data.draw(st.integers(0, len(changed) - 1))] ^= data.draw(st.integers(1, 255))
    assume(name != b"IHDR" or len(set(struct.unpack_from(">II", changed)) - set(range(1 << 12))) == 0)
    chunks[at] = (name, bytes(changed))
    assert_same_as_others(file_of(chunks))


@given(plain_chunks(), st.data())
def test_cut_and_extended_files(chunks, data):
    whole = file_of(chunks)
    assert_same_as_others(whole[: data.draw(st.integers(0, len(whole)))])
    assert_same_as_others(whole + data.draw(st.binary(min_size=1, max_size=20)))


@given(plain_chunks(), st.integers(-3, 3).filter(bool), st.integers(0, 9))
def test_more_or_fewer_lines_than_declared(chunks, rows, level):
    width, height, *rest = struct.unpack(">IIBBBBB", chunks[0][1])
    assert_same_as_others(
        file_of([(b"IHDR", struct.pack(">IIBBBBB", width, max(height + rows, 0), *rest)), *chunks[1:]])
    )


@given(window_bits=st.integers(9, 15), declared=st.integers(0, 8))
def test_a_stream_of_every_window(window_bits, declared):
    """zlib refuses a stream that looks back farther than its declared window."""
    rows = np.random.default_rng(1).integers(0, 256, (40, 1 + 3 * 100), dtype=np.uint8)
    rows[:, 0] = 0
    rows[20:] = rows[:20]  # 6020 bytes back
    compressor = zlib.compressobj(9, wbits=window_bits)
    stream = bytearray(compressor.compress(rows.tobytes()) + compressor.flush())
    stream[0] = declared << 4 | 8
    stream[1] = -(stream[0] << 8) % 31
    assert_same_as_others(file_of([header(100, 40, 8, 2), (b"IDAT", bytes(stream)), (b"IEND", b"")]))


@given(
    mode=st.sampled_from(("1", "L", "LA", "P", "RGB", "RGBA", "I;16")),
    pixels=arrays(np.uint8, st.tuples(SIDES, SIDES)),
    bits=st.sampled_from((1, 2, 4, 8)),
    optimize=st.booleans(),
)
def test_pngs_of_pillow(mode, pixels, bits, optimize):
    image = PillowImage.fromarray(pixels & ((1 << bits) - 1), "L")
    if mode == "P":
        image.putpalette(bytes(range(256)) * 3)
    stream = io.BytesIO()
    image.convert(mode).save(stream, "PNG", bits=bits if mode == "P" else 8, optimize=optimize)
    assert_same_as_others(stream.getvalue())


@pytest.mark.parametrize("methods", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 64, 0), (0, 0, 2)])
@pytest.mark.parametrize("colour_type", [0, 2, 3, 6])
def test_other_methods_and_interlaced_pixels(methods, colour_type):
    lines = bytes(4 * (1 + 8 * CHANNELS[colour_type]) * 3)
    palette = [PALETTE] * (colour_type == 3)
    start = [header(8, 4, 8, colour_type, methods), *palette]
    assert_same_as_others(file_of([*start, (b"IDAT", zlib.compress(lines)), (b"IEND", b"")]))


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
