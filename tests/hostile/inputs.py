"""Hostile inputs: kilobytes that declare gigabytes, records with wrong lengths, names with control characters."""

import dataclasses
import struct
import zlib

import lz4.frame
import polars as pl
from mcap.opcode import Opcode

from roadperc_stream.log import Metadata
from tests import logs
from tests.analytic import box

_LZ4_BLOCK = 4 * 1024 * 1024


GROWTH_BYTES = 3 * 2**29
"""New memory of a command, at most."""


def replaced(role, data, frames=2):
    """The messages of a log in which all messages of a role have these data."""
    return [dataclasses.replace(item, data=data) if item.role == role else item for item in logs.items(frames)]


def lz4_zeros(size):
    """An lz4 frame of `size` zeros, a multiple of 4 MiB; its header does not declare the size."""
    frame = lz4.frame.compress(
        bytes(_LZ4_BLOCK), block_size=lz4.frame.BLOCKSIZE_MAX4MB, block_linked=False, store_size=False
    )
    head, block = frame[:7], frame[7:-4]
    return head + block * (size // _LZ4_BLOCK) + bytes(4)


def jpeg_of_size(jpeg, width, height):
    """The JPEG with another size in its header."""
    at = jpeg.index(b"\xff\xc0") + 5
    return jpeg[:at] + struct.pack(">HH", height, width) + jpeg[at + 4 :]


MAGIC = b"\x89MCAP0\r\n"


def record(opcode, *parts, length=None):
    """A record of these parts; ``length`` is another length than the true one."""
    content = b"".join(parts)
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def text(data):
    """Bytes after their length in 32 bits."""
    return struct.pack("<I", len(data)) + data


def schema(number, name, encoding, data):
    return record(Opcode.SCHEMA, struct.pack("<H", number), text(name.encode()), text(encoding.encode()), text(data))


def channel(number, of, topic, encoding):
    ids = struct.pack("<HH", number, of)
    return record(Opcode.CHANNEL, ids, text(topic.encode()), text(encoding.encode()), text(b""))


def message(of, time_ns, data, length=None):
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", of, 0, time_ns, time_ns), data, length=length)


def attachment(length):
    """An attachment that declares this length of its data."""
    times = struct.pack("<QQ", 0, 0)
    return record(Opcode.ATTACHMENT, times, text(b"a"), text(b"b"), struct.pack("<Q", length), bytes(4))


def chunk(data, compression="", *, size, length=None):
    """A chunk that declares ``size`` uncompressed bytes and ``length`` compressed ones."""
    stored = struct.pack("<Q", len(data) if length is None else length)
    return record(Opcode.CHUNK, struct.pack("<QQQI", 1, 1, size, 0), text(compression.encode()), stored, data)


def file(*records):
    """A file of these records, without a summary."""
    end = record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20))
    return MAGIC + record(Opcode.HEADER, text(b""), text(b"hostile")) + b"".join(records) + end + MAGIC


def zeros_as_zstd(size, *, stated=True):
    """A zstd frame of `size` zeros, in blocks of 128 kB (RFC 8878); with `stated` its header declares the size."""
    block = 128 * 1024
    count = -(-size // block)
    blocks = (struct.pack("<I", (block << 3) | 0b010)[:3] + b"\0") * (count - 1)
    last = size - (count - 1) * block
    blocks += struct.pack("<I", (last << 3) | 0b011)[:3] + b"\0"
    head = struct.pack("<IBB", 0xFD2FB528, 0b11000000 if stated else 0, 0b01101000)
    return head + (struct.pack("<Q", size) if stated else b"") + blocks


def png(width, height, *, mode=2, extra=()):
    """A PNG whose header declares this size, with four rows of zeros; ``extra`` are (name, content) of chunks."""
    channels = {0: 1, 2: 3, 3: 1}[mode]
    rows = zlib.compress(bytes(4 * (1 + width * channels)), 9)
    header = struct.pack(">IIBBBBB", width, height, 8, mode, 0, 0, 0)
    chunks = [(b"IHDR", header), *extra, (b"PLTE", bytes(48)), (b"IDAT", rows), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        for name, content in chunks
        if name != b"PLTE" or mode == 3
    )


POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n{} loop\n%%EOF\n"


EVIL = "x\x1b[31m\r\n\x07\x9b2J\u202ez[bold]"
"""A colour, a new line, the bell, C1's code to clear the screen, right-to-left text, and rich's markup."""
SHOWN = r"x\x1b[31m\r\n\x07\x9b2J\u202ez[bold]"
"""EVIL as it must be printed."""
COMMANDS = frozenset("\x1b\r\x07\x9b\u202e")


def write_log(path, name=EVIL):
    """Write a log whose topics, schemas, frames, labels and metadata contain `name`."""
    items = [dataclasses.replace(item, topic=f"/{item.role}/{name}") for item in logs.items(roles=logs.ALL[:-1])]
    stamp = items[-1].stamp_ns
    boxes = logs.encoding.encode_detections(stamp, name, [box(name, 20, 60, 60, 90)])
    items.append(logs.Item("detections", stamp, boxes, f"/detections/{name}"))
    items.append(logs.Item("image", stamp + 1, b"no image", f"/image/{name}"))
    with logs.LogWriter(path) as writer:
        for sequence, item in enumerate(items):
            writer.write(logs.message(item, sequence, **{name: name}))
        odd = dataclasses.replace(logs.foreign().channel, topic=f"/odd/{name}", schema_name=name, message_encoding=name)
        writer.write(dataclasses.replace(logs.foreign(), channel=odd, log_time_ns=stamp, publish_time_ns=stamp))
        writer.describe(Metadata(name, ((name, name),)))
    return path


def topic_options(name=EVIL):
    return [word for role in logs.ALL for word in ("--topic", f"{role}=/{role}/{name}")]


def taint(path, name=EVIL):
    """Put `name` into every text of a metrics table except `log_id`, and into its metadata."""
    table = pl.read_parquet(path)
    texts = [c for c, t in table.schema.items() if t == pl.String and c != "log_id"]
    lists = [c for c, t in table.schema.items() if t == pl.List(pl.String)]
    table = table.with_columns(
        *(pl.lit(name).alias(c) for c in texts), *(pl.lit([name], pl.List(pl.String)).alias(c) for c in lists)
    )
    facts = pl.read_parquet_metadata(path) | {"roadperc.version": name, "roadperc.source": name, "roadperc.log": name}
    table.write_parquet(path, metadata={k: v for k, v in facts.items() if not k.startswith("ARROW")})
    return path
