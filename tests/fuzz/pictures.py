"""PNG and JPEG files changed part by part: sizes, depths, palettes and markers, with checksums that fit or do not."""

import base64
import struct
import zlib
from collections.abc import Callable

from tests.fuzz.choices import Choices, damage

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
SIZES = (0, 1, 2, 31, 33, 1000, 9999, 12_000, 30_000, 65_535, 2**31 - 1, 2**32 - 1)
JPEG_SIZES = (0, 1, 31, 33, 5000, 12_000, 30_000, 65_535)
NEW_CHUNKS = {
    "tRNS": b"\0", "tIME": b"\0" * 7, "tEXt": b"Comment\0" + b"x" * 100, "iCCP": b"name\0\0" + b"\1" * 20,
    "gAMA": b"\0\0\0\0", "pHYs": b"\0" * 9, "PLTE": b"\1\2\3", "acTL": b"\0\0\0\5\0\0\0\0", "eXIf": b"MM\0*\0\0\0\x08",
    "zTXt": b"Comment\0\0" + zlib.compress(bytes(2_000_000)), "sBIT": b"\0", "XXXX": b"", "iTXt": b"", "bKGD": b"\xff",
}  # fmt: skip

AVIF = zlib.decompress(
    base64.b85decode(
        "c-muNV30{GsVqn=%S>Yc0uY^>nP!-qnF!*)%uOvxWPkw0jFg-rD4U@mGr5ET4e%9YmgIt2j6f`xnUkLk;<$kLj1W;qUIqsC<v_MZ"
        "W@cU*T&)z4lgb3;C6*Z&I_Kx)gYC-5EGQ}f(w><G$@xH9B(u066>47s5PLxEt;hsx<^U2riDib)jq)-e0paBQoT9wsoC*de5NrSn"
        "iDwq%!h8gD77HU&GYim7>vK~QON1D>IOM<A)&Kmv)WK*5zkteOfy3ubgcumC&YyA1cy=q<W_R?v_Orsvw}{R95csArOe51qe0yQ7"
        "ikqGJwTy}860ET|ghZCl?SC*Us94hY-ZU}&-4CqKp9!is7OH7k!T6VxZ-JImex3P`pBwH*$KU5j`X}*vd*RikI+BXB>*vgAjQx5o"
        "lEcwaV&4DTx-2e@TeN7c`RJdF4UzjQ7w_MoF!h<J#7DPDcXSSET+F=HFsPk9>gQ2EkNSDk&!c|E@UuCYHZ##*BbnZG007mm+wu"
    )
)
"""Of 96x72 pixels by its container, with a black frame of 16000x16000."""
POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n{} loop\n%%EOF\n"
OTHER_FORMATS = {"avif": AVIF, "postscript": POSTSCRIPT, "bmp": b"BM" + bytes(99), "tiff": b"II*\0\x08" + bytes(99)}


def mutate_picture(data: bytes, choices: Choices) -> bytes:
    """An encoded image with one fault."""
    if choices.chance("bytes", 0.2):
        return damage(data, choices.part("damage"))
    if data.startswith(PNG_MAGIC):
        if choices.chance("foreign", 0.05):
            return OTHER_FORMATS[choices.of("format", tuple(OTHER_FORMATS))]
        return _mutate_png(data, choices)
    if data.startswith(b"\xff\xd8"):
        return _mutate_jpeg(data, choices)
    return damage(data, choices.part("damage"))


def _mutate_png(data: bytes, choices: Choices) -> bytes:
    chunks = png_chunks(data)
    at = choices.index("chunk", len(chunks))
    fault = choices.of(
        "fault", ("zeros", "size", "size", "depth", "remove", "repeat", "move", "palette", "new", "content", "inflate")
    )
    if fault in _IN_A_LIST:
        _IN_A_LIST[fault](chunks, at, choices)
    elif fault == "zeros":
        chunks[:] = _zeros(chunks[0][1], choices.of("side", (100, 3000, 30_000)))
    elif fault == "size":
        chunks[0][1] = _with_a_size(chunks[0][1], 0, ">I", choices.of("size", SIZES), choices)
    elif fault == "depth":
        chunks[0][1] = _with_byte(chunks[0][1], choices.of("where", (8, 9, 10, 11, 12)), choices)
    elif fault == "palette":
        palette = bytes(range(256)) * 3
        chunks.insert(1, [b"PLTE", palette[: choices.of("length", (0, 1, 3, 6, 765, 768))]])
    elif fault == "new":
        name = choices.of("name", tuple(NEW_CHUNKS))
        chunks.insert(choices.number("to", 1, len(chunks)), [name.encode(), NEW_CHUNKS[name]])
    else:
        _repack(chunks, choices)
    return png_of(chunks, fixed=choices.chance("fixed", 0.8))


def _repeat(parts: list[list], at: int, choices: Choices) -> None:
    parts[at:at] = [list(parts[at])] * choices.of("copies", (1, 100))


def _damage(parts: list[list], at: int, choices: Choices) -> None:
    parts[at][1] = damage(parts[at][1], choices.part("damage"))


_IN_A_LIST: dict[str, Callable[[list[list], int, Choices], object]] = {
    "remove": lambda parts, at, _: parts.pop(at),
    "move": lambda parts, at, choices: parts.insert(choices.index("to", len(parts)), parts.pop(at)),
    "repeat": _repeat,
    "content": _damage,
}
"""Of a PNG's chunks and of a JPEG's segments."""


def _zeros(header: bytes, side: int) -> list[list[bytes]]:
    """A square picture that is all there, its pixels zeros: a megabyte of them takes a kilobyte."""
    piece = 2**20
    count, rest = divmod(side * (side * 4 + 1), piece)  # as many as the widest kind of pixel takes
    pieces = _deflated(piece) * count + _deflated(rest)
    checksum = struct.pack(">HH", side * (side * 4 + 1) % 65521, 1)  # Adler-32 of zeros
    packed = b"\x78\x9c" + pieces + b"\x03\0" + checksum
    size = struct.pack(">II", side, side)
    return [[b"IHDR", size + header[8:]], [b"PLTE", bytes(768)], [b"IDAT", packed], [b"IEND", b""]]


def _deflated(count: int) -> bytes:
    """So many zeros, compressed so that any number of such pieces may stand one behind the other."""
    writer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return writer.compress(bytes(count)) + writer.flush(zlib.Z_FULL_FLUSH)


def _repack(chunks: list[list[bytes]], choices: Choices) -> None:
    """The pixels themselves damaged below their compression, or more of them than the header says."""
    packed = b"".join(content for name, content in chunks if name == b"IDAT")
    try:
        pixels = zlib.decompress(packed)
    except zlib.error:
        return
    more = choices.of("more", (0, 0, 1, 1000, 20_000_000))
    changed = zlib.compress(damage(pixels, choices.part("damage")) + bytes(more))
    chunks[:] = [chunk for chunk in chunks if chunk[0] != b"IDAT"]
    chunks.insert(max(len(chunks) - 1, 0), [b"IDAT", changed])


def _with_a_size(header: bytes, at: int, layout: str, size: int, choices: Choices) -> bytes:
    """The header with one or both of two neighbouring numbers replaced."""
    packed, first, count = struct.pack(layout, size), *choices.of("which", ((0, 1), (1, 1), (0, 2)))
    at += first * len(packed)
    return header[:at] + packed * count + header[at + count * len(packed) :]


def _with_byte(data: bytes, where: int, choices: Choices) -> bytes:
    value = choices.of("byte", (0, 1, 2, 3, 4, 6, 7, 8, 16, 32, 255))
    return data[:where] + bytes([value]) + data[where + 1 :]


def png_chunks(data: bytes) -> list[list[bytes]]:
    """[name, content] of each chunk as far as they can be read; never empty."""
    chunks, at = [], len(PNG_MAGIC)
    while at + 8 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        chunks.append([data[at + 4 : at + 8], data[at + 8 : at + 8 + length]])
        at += 12 + length
    return chunks or [[b"IHDR", struct.pack(">IIBBBBB", 32, 24, 8, 0, 0, 0, 0)]]


def png_of(chunks: list[list[bytes]], *, fixed: bool = True) -> bytes:
    """A PNG of chunks, their checksums right or all the same."""
    made = [PNG_MAGIC]
    for name, content in chunks:
        crc = zlib.crc32(name + content) if fixed else 0x12345678
        made.append(struct.pack(">I", len(content)) + name + content + struct.pack(">I", crc))
    return b"".join(made)


def _mutate_jpeg(data: bytes, choices: Choices) -> bytes:
    segments, scan = jpeg_segments(data)
    if not segments:
        return damage(data, choices.part("damage"))
    at = choices.index("segment", len(segments))
    fault = choices.of(
        "fault", ("size", "size", "remove", "repeat", "move", "length", "marker", "content", "cut", "components")
    )
    frames = [k for k, (marker, _) in enumerate(segments) if marker in (0xC0, 0xC2)]
    if fault in ("size", "components") and frames:
        segments[frames[0]][1] = _frame_header(segments[frames[0]][1], fault, choices)
    elif fault in _IN_A_LIST:
        _IN_A_LIST[fault](segments, at, choices)
    elif fault == "length":
        segments[at].append(choices.of("length", (0, 1, 2, 17, 65535)))
    elif fault == "marker":
        segments[at][0] = choices.of("marker", (0x00, 0x01, 0xC1, 0xC3, 0xC9, 0xD8, 0xD9, 0xDA, 0xE1, 0xFE, 0xFF))
    else:
        scan = damage(scan, choices.part("damage"))
    return jpeg_of(segments, scan)


def _frame_header(content: bytes, fault: str, choices: Choices) -> bytes:
    """Of a frame segment: precision, rows, columns, number of components, then three bytes for each."""
    if fault == "components":
        return _with_byte(content, choices.of("where", (0, 5, 6, 7, 8)), choices)
    return _with_a_size(content, 1, ">H", choices.of("size", JPEG_SIZES), choices)


def jpeg_segments(data: bytes) -> tuple[list[list], bytes]:
    """[marker, content] of each segment up to the scan, and what follows from there."""
    segments, at = [], 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, (length,) = data[at + 1], struct.unpack_from(">H", data, at + 2)
        segments.append([marker, data[at + 4 : at + 2 + length]])
        at += 2 + length
        if marker == 0xDA:
            break
    return segments, data[at:]


def jpeg_of(segments: list[list], scan: bytes) -> bytes:
    """A JPEG of segments; one with a third item states that as its length."""
    made = [b"\xff\xd8"]
    for marker, content, *stated in segments:
        made.append(struct.pack(">BBH", 0xFF, marker, *stated or [(len(content) + 2) & 0xFFFF]) + content)
    return b"".join(made) + scan
