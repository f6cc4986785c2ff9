"""MCAP files record by record, with whatever lengths one likes. Layout: https://mcap.dev/spec."""

import struct

from roadperc_stream.log.integrity import MAGIC

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, CHUNK_INDEX = 1, 2, 3, 4, 5, 6, 8
ATTACHMENT, STATISTICS, METADATA, DATA_END = 9, 11, 12, 15


def record(opcode, body, length=None):
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def text(value):
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def schema(number, name, encoding, data):
    return record(SCHEMA, struct.pack("<H", number) + text(name) + text(encoding) + text(data))


def channel(number, of, topic, encoding):
    return record(CHANNEL, struct.pack("<HH", number, of) + text(topic) + text(encoding) + text(b""))


def message(of, time_ns, data, length=None):
    return record(MESSAGE, struct.pack("<HIQQ", of, 0, time_ns, time_ns) + data, length)


def chunk(data, compression="", *, size, length=None):
    """A chunk whose header says that it is ``size`` bytes without compression, and ``length`` with it."""
    stored = len(data) if length is None else length
    return record(CHUNK, struct.pack("<QQQI", 1, 1, size, 0) + text(compression) + struct.pack("<Q", stored) + data)


def file(*records, index=()):
    """A file of these records; ``index`` are those of its summary."""
    data = MAGIC + record(HEADER, text("") + text("hostile")) + b"".join(records) + record(DATA_END, bytes(4))
    summary = b"".join(index)
    return data + summary + record(FOOTER, struct.pack("<QQI", len(data) if summary else 0, 0, 0)) + MAGIC


def indexed(chunk_record, *records, size, messages=1):
    """A file of one chunk with an index that says the same as the chunk, and these schemas and channels."""
    start = len(MAGIC) + len(record(HEADER, text("") + text("hostile")))
    place = struct.pack("<QQQQIQ", 1, 1, start, len(chunk_record), 0, 0)
    entry = record(CHUNK_INDEX, place + text("zstd") + struct.pack("<QQ", len(chunk_record), size))
    counts = struct.pack("<IHQ", 10, 1, messages)
    facts = struct.pack("<QHIIIIQQ", messages, 1, 1, 0, 0, 1, 1, 1) + counts
    return file(chunk_record, index=(*records, record(STATISTICS, facts), entry))
