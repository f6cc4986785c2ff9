"""Faults in PNG files: sizes, depths, palettes and chunks, with right or wrong checksums. In a JPEG bytes change."""

import base64
import struct
import zlib
from collections.abc import Callable

from tests.fuzz.choices import Choices, damage

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
SIZES = (0, 1, 2, 31, 33, 1000, 5000, 9999, 12_000, 30_000, 65_535, 2**31 - 1, 2**32 - 1)
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
"""The container declares 96x72 pixels; the coded frame is black and has 16000x16000."""
POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n{} loop\n%%EOF\n"
OTHER_FORMATS = {"avif": AVIF, "postscript": POSTSCRIPT, "bmp": b"BM" + bytes(99), "tiff": b"II*\0\x08" + bytes(99)}


def mutate_picture(data: bytes, choices: Choices) -> bytes:
    """An encoded image with one fault."""
    if choices.chance("bytes", 0.2) or not data.startswith(PNG_MAGIC):
        return damage(data, choices.part("damage"))
    if choices.chance("foreign", 0.03):
        return OTHER_FORMATS[choices.of("format", tuple(OTHER_FORMATS))]
    return _mutate_png(data, choices)


def _damage_chunk(chunks: list[list[bytes]], at: int, choices: Choices) -> None:
    chunks[at][1] = damage(chunks[at][1], choices.part("damage"))


PART_FAULTS: dict[str, Callable[[list[list[bytes]], int, Choices], object]] = {
    "content": _damage_chunk, "remove": lambda chunks, at, _: chunks.pop(at),
    "repeat": lambda chunks, at, _: chunks.insert(at, list(chunks[at])),
    "move": lambda chunks, at, c: chunks.insert(c.index("to", len(chunks)), chunks.pop(at)),
}  # fmt: skip


def _mutate_png(data: bytes, choices: Choices) -> bytes:
    chunks = png_chunks(data)
    fault = choices.of("fault", ("size", "size", "zeros", "depth", "palette", "new", "inflate", *PART_FAULTS))
    if fault == "zeros":
        return png(*[choices.of("side", (100, 3000, 30_000))] * 2, mode=choices.of("mode", (0, 3)), bits=1)
    if fault == "size":
        chunks[0][1] = _with_a_size(chunks[0][1], choices)
    elif fault == "depth":
        where, header = choices.of("where", (8, 9, 10, 11, 12)), chunks[0][1]
        value = choices.of("byte", (0, 1, 2, 3, 4, 6, 7, 8, 16, 32, 255))
        chunks[0][1] = header[:where] + bytes([value]) + header[where + 1 :]
    elif fault == "palette":
        palette = bytes(range(256)) * 3
        chunks.insert(1, [b"PLTE", palette[: choices.of("length", (0, 1, 3, 6, 765, 768))]])
    elif fault == "new":
        name = choices.of("name", tuple(NEW_CHUNKS))
        chunks.insert(choices.number("to", 1, len(chunks)), [name.encode(), NEW_CHUNKS[name]])
    elif fault == "inflate":
        _repack(chunks, choices)
    else:
        PART_FAULTS[fault](chunks, choices.index("chunk", len(chunks)), choices)
    return png_of(chunks, fixed=choices.chance("fixed", 0.8))


def _repack(chunks: list[list[bytes]], choices: Choices) -> None:
    """Damage the pixels below their compression, or add more than the header declares."""
    packed = b"".join(content for name, content in chunks if name == b"IDAT")
    try:
        pixels = zlib.decompress(packed)
    except zlib.error:
        return
    more = choices.of("more", (0, 0, 1, 1000, 20_000_000))
    changed = zlib.compress(damage(pixels, choices.part("damage")) + bytes(more))
    chunks[:] = [chunk for chunk in chunks if chunk[0] != b"IDAT"]
    chunks.insert(max(len(chunks) - 1, 0), [b"IDAT", changed])


def _with_a_size(header: bytes, choices: Choices) -> bytes:
    """The header with another width, height or both."""
    packed = struct.pack(">I", choices.of("size", SIZES))
    first, count = choices.of("which", ((0, 1), (1, 1), (0, 2)))
    return header[: 4 * first] + packed * count + header[4 * (first + count) :]


def png_chunks(data: bytes) -> list[list[bytes]]:
    """[name, content] of each readable chunk; never empty."""
    chunks, at = [], len(PNG_MAGIC)
    while at + 8 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        chunks.append([data[at + 4 : at + 8], data[at + 8 : at + 8 + length]])
        at += 12 + length
    return chunks or [[b"IHDR", struct.pack(">IIBBBBB", 32, 24, 8, 0, 0, 0, 0)]]


def png_of(chunks: list[list[bytes]], *, fixed: bool = True) -> bytes:
    """A PNG of these chunks, with right checksums or with wrong ones."""
    made = [PNG_MAGIC]
    for name, content in chunks:
        crc = zlib.crc32(name + content) if fixed else 0x12345678
        made.append(struct.pack(">I", len(content)) + name + content + struct.pack(">I", crc))
    return b"".join(made)


def png(width: int, height: int, *, mode: int = 2, bits: int = 8, extra: tuple = (), rows: int | None = None) -> bytes:
    """A PNG whose header declares this size; its first `rows` rows (default: all) are zeros.

    ``extra`` are [name, content] of chunks after the header.
    """
    channels = {0: 1, 2: 3, 3: 1, 6: 4}[mode]
    row = bytes(1 + (width * channels * bits + 7) // 8)
    packer = zlib.compressobj(9)
    pixels = b"".join(packer.compress(row) for _ in range(height if rows is None else rows)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, bits, mode, 0, 0, 0)
    palette = [[b"PLTE", bytes(range(3 * min(16, 2**bits)))]] if mode == 3 else []
    return png_of([[b"IHDR", header], *extra, *palette, [b"IDAT", pixels], [b"IEND", b""]])
