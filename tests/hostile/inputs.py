"""Hostile inputs: kilobytes that declare gigabytes, records with wrong lengths, names with control characters."""

import dataclasses
import struct

import lz4.frame
import polars as pl
from mcap.opcode import Opcode

from roadperc_stream.log import Metadata
from tests import logs
from tests.analytic import box
from tests.fuzz.records import MAGIC, Record, filled

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


def record(opcode, fields, **options):
    """A record with these fields; the others are zeros."""
    return Record(opcode, filled(opcode, fields), **options)


HEADER = record(Opcode.HEADER, {"library": b"hostile"}).packed()


def schema(number, name, encoding, data):
    fields = {"id": number, "name": name.encode(), "encoding": encoding.encode(), "data": data}
    return record(Opcode.SCHEMA, fields).packed()


def channel(number, of, topic, encoding):
    fields = {"id": number, "schema_id": of, "topic": topic.encode(), "encoding": encoding.encode()}
    return record(Opcode.CHANNEL, fields).packed()


def message(of, time_ns, data, length=None):
    fields = {"channel_id": of, "log_time": time_ns, "publish_time": time_ns, "data": data}
    return record(Opcode.MESSAGE, fields, length=length).packed()


def attachment(length):
    """An attachment that declares this length of its data."""
    return record(Opcode.ATTACHMENT, {"name": b"a", "media_type": b"b"}, lies={"data": length}).packed()


def chunk(data, compression="", *, size, length=None):
    """A chunk that declares ``size`` uncompressed bytes and ``length`` compressed ones."""
    fields = {"start": 1, "end": 1, "size": size, "compression": compression.encode(), "records": data}
    return record(Opcode.CHUNK, fields, lies={} if length is None else {"records": length}).packed()


def file(*records, index=()):
    """A file of these records; ``index`` are the records of its summary."""
    data = MAGIC + HEADER + b"".join(records) + record(Opcode.DATA_END, {}).packed()
    summary = b"".join(index)
    footer = record(Opcode.FOOTER, {"summary_start": len(data) if summary else 0})
    return data + summary + footer.packed() + MAGIC


def indexed(chunk_record, *records, size, messages=1):
    """A file of one chunk with an index that declares ``size``, and these schemas and channels."""
    place = {"start": 1, "end": 1, "offset": len(MAGIC + HEADER), "length": len(chunk_record)}
    entry = record(
        Opcode.CHUNK_INDEX, {**place, "compression": b"zstd", "compressed_size": len(chunk_record), "size": size}
    )
    counts = {"messages": messages, "schemas": 1, "channels": 1, "chunks": 1, "start": 1, "end": 1}
    statistics = record(Opcode.STATISTICS, {**counts, "counts": struct.pack("<HQ", 1, messages)})
    return file(chunk_record, index=(*records, statistics.packed(), entry.packed()))


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
