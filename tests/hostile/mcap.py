"""MCAP files record by record, with whatever lengths one likes."""

import struct

from mcap.opcode import Opcode

from tests.fuzz.records import MAGIC, Record, filled


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
    """An attachment that says that its data have this length."""
    return record(Opcode.ATTACHMENT, {"name": b"a", "media_type": b"b"}, lies={"data": length}).packed()


def chunk(data, compression="", *, size, length=None):
    """A chunk whose header says that it is ``size`` bytes without compression, and ``length`` with it."""
    fields = {"start": 1, "end": 1, "size": size, "compression": compression.encode(), "records": data}
    return record(Opcode.CHUNK, fields, lies={} if length is None else {"records": length}).packed()


def file(*records, index=()):
    """A file of these records; ``index`` are those of its summary."""
    data = MAGIC + HEADER + b"".join(records) + record(Opcode.DATA_END, {}).packed()
    summary = b"".join(index)
    footer = record(Opcode.FOOTER, {"summary_start": len(data) if summary else 0})
    return data + summary + footer.packed() + MAGIC


def indexed(chunk_record, *records, size, messages=1):
    """A file of one chunk with an index that says the same as the chunk, and these schemas and channels."""
    place = {"start": 1, "end": 1, "offset": len(MAGIC + HEADER), "length": len(chunk_record)}
    entry = record(
        Opcode.CHUNK_INDEX, {**place, "compression": b"zstd", "compressed_size": len(chunk_record), "size": size}
    )
    counts = {"messages": messages, "schemas": 1, "channels": 1, "chunks": 1, "start": 1, "end": 1}
    statistics = record(Opcode.STATISTICS, {**counts, "counts": struct.pack("<HQ", 1, messages)})
    return file(chunk_record, index=(*records, statistics.packed(), entry.packed()))
