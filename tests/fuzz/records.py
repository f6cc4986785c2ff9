"""Parses the records of an MCAP log, changes them, and writes them with right or wrong offsets and checksums.

Layout: https://mcap.dev/spec. The mcap library cannot write invalid records.
"""

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from tests.fuzz.choices import Choices, damage, wild_integer, wild_text

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
LAYOUTS: dict[int, tuple[tuple[str, str], ...]] = {
    Opcode.HEADER: (("profile", "s"), ("library", "s")),
    Opcode.FOOTER: (("summary_start", "Q"), ("summary_offset_start", "Q"), ("crc", "I")),
    Opcode.SCHEMA: (("id", "H"), ("name", "s"), ("encoding", "s"), ("data", "d")),
    Opcode.CHANNEL: (("id", "H"), ("schema_id", "H"), ("topic", "s"), ("encoding", "s"), ("metadata", "d")),
    Opcode.MESSAGE: (("channel_id", "H"), ("sequence", "I"), ("log_time", "Q"), ("publish_time", "Q"), ("data", "r")),
    Opcode.CHUNK: (("start", "Q"), ("end", "Q"), ("size", "Q"), ("crc", "I"), ("compression", "s"), ("records", "D")),
    Opcode.MESSAGE_INDEX: (("channel_id", "H"), ("records", "d")),
    Opcode.CHUNK_INDEX: (
        ("start", "Q"), ("end", "Q"), ("offset", "Q"), ("length", "Q"), ("indexes", "d"), ("indexes_length", "Q"),
        ("compression", "s"), ("compressed_size", "Q"), ("size", "Q"),
    ),
    Opcode.ATTACHMENT: (
        ("log_time", "Q"), ("create_time", "Q"), ("name", "s"), ("media_type", "s"), ("data", "D"), ("crc", "I"),
    ),
    Opcode.ATTACHMENT_INDEX: (
        ("offset", "Q"), ("length", "Q"), ("log_time", "Q"), ("create_time", "Q"), ("data_size", "Q"), ("name", "s"),
        ("media_type", "s"),
    ),
    Opcode.STATISTICS: (
        ("messages", "Q"), ("schemas", "H"), ("channels", "I"), ("attachments", "I"), ("metadata", "I"),
        ("chunks", "I"), ("start", "Q"), ("end", "Q"), ("counts", "d"),
    ),
    Opcode.METADATA: (("name", "s"), ("metadata", "d")),
    Opcode.METADATA_INDEX: (("offset", "Q"), ("length", "Q"), ("name", "s")),
    Opcode.SUMMARY_OFFSET: (("group", "B"), ("start", "Q"), ("length", "Q")),
    Opcode.DATA_END: (("crc", "I"),),
}  # fmt: skip
"""Fields of each record. s, d and D follow a length of 32, 32 and 64 bits; r is the rest of the record."""
_LENGTHS = {"s": "<I", "d": "<I", "D": "<Q"}


@dataclass
class Record:
    """A record by its fields; a chunk also has its records."""

    opcode: int
    fields: dict[str, Any]
    inner: "list[Record] | None" = None
    length: int | None = None
    """The declared length, if it is wrong."""
    lies: dict[str, int] = field(default_factory=dict)
    """Wrong declared lengths of fields."""
    held: set[str] = field(default_factory=set)
    """Fields that were changed on purpose and are not repaired."""

    def packed(self) -> bytes:
        """Opcode, length and content."""
        content = b"".join(self._packed(name, kind) for name, kind in LAYOUTS.get(self.opcode, (("data", "r"),)))
        return _HEAD.pack(self.opcode, len(content) if self.length is None else self.length) + content

    def _packed(self, name: str, kind: str) -> bytes:
        value = self.fields[name]
        if kind == "r":
            return bytes(value)
        if kind in _LENGTHS:
            wide = struct.calcsize(_LENGTHS[kind]) * 8
            return struct.pack(_LENGTHS[kind], self.lies.get(name, len(value)) % (1 << wide)) + value
        return struct.pack(f"<{kind}", value % (1 << (8 * struct.calcsize(f"<{kind}"))))


def filled(opcode: int, fields: dict[str, Any]) -> dict[str, Any]:
    """All fields of a record; those not given are zeros."""
    return {name: b"" if kind in "sdDr" else 0 for name, kind in LAYOUTS.get(opcode, (("data", "r"),))} | fields


def taken_apart(data: bytes) -> list[Record]:
    """The records of an intact log."""
    return _records(data[len(MAGIC) : -len(MAGIC)])


def _records(data: bytes) -> list[Record]:
    found, at = [], 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        record = Record(opcode, _fields(opcode, data[at : at + length]))
        if opcode == Opcode.CHUNK:
            record.inner = _records(_DECOMPRESS.get(record.fields["compression"], bytes)(record.fields["records"]))
        found.append(record)
        at += length
    return found


def _fields(opcode: int, content: bytes) -> dict[str, Any]:
    values: dict[str, Any] = {}
    at = 0
    for name, kind in LAYOUTS.get(opcode, (("data", "r"),)):
        if kind == "r":
            values[name] = content[at:]
        elif kind in _LENGTHS:
            (length,) = struct.unpack_from(_LENGTHS[kind], content, at)
            at += struct.calcsize(_LENGTHS[kind])
            values[name] = content[at : at + length]
            at += length
        else:
            (values[name],) = struct.unpack_from(f"<{kind}", content, at)
            at += struct.calcsize(f"<{kind}")
    return values


_COMPRESS = {b"zstd": zstandard.compress, b"lz4": lz4.frame.compress}
_DECOMPRESS = {b"zstd": zstandard.decompress, b"lz4": lz4.frame.decompress}


FIXES = ("nothing", "checksums", "everything")
WEIGHTED_FIXES = (*FIXES, "everything", "everything")


def put_together(records: list[Record], fix: str) -> bytes:
    """The bytes of a log.

    Args:
        records: are changed in place.
        fix: what to repair: nothing, checksums, or everything (checksums, sizes and offsets).
    """
    for record in records:
        if record.opcode == Opcode.CHUNK and record.inner is not None and "records" not in record.held:
            _pack_chunk(record, fix)
    if fix == "everything":
        _place(records)
    parts = [MAGIC]
    crc = zlib.crc32(MAGIC)
    for record in records:
        if fix != "nothing" and record.opcode in (Opcode.DATA_END, Opcode.FOOTER) and "crc" not in record.held:
            # The footer's checksum covers its own record. A checksum of 0 means that there is none.
            covered = record.packed()[:-4] if record.opcode == Opcode.FOOTER else b""
            record.fields["crc"] = zlib.crc32(covered, crc) if record.fields["crc"] else 0
        if fix != "nothing" and record.opcode == Opcode.ATTACHMENT and "crc" not in record.held:
            record.fields["crc"] = zlib.crc32(record.packed()[_HEAD.size : -4])
        parts.append(record.packed())
        crc = 0 if record.opcode == Opcode.DATA_END else zlib.crc32(parts[-1], crc)
    return b"".join([*parts, MAGIC])


def _pack_chunk(chunk: Record, fix: str) -> None:
    data = b"".join(record.packed() for record in chunk.inner or ())
    codec = chunk.fields["compression"] if "compression" not in chunk.held else b"zstd"
    chunk.fields["records"] = _COMPRESS.get(codec, bytes)(data)
    if fix != "nothing":
        right = {"size": len(data), "crc": zlib.crc32(data) if chunk.fields["crc"] else 0}
        chunk.fields |= {name: value for name, value in right.items() if name not in chunk.held}


_INDEXED = {
    Opcode.CHUNK: Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT: Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA: Opcode.METADATA_INDEX,
}


def _place(records: list[Record]) -> None:
    """Repair the offsets in the indexes; extra indexes stay as they are."""
    for chunk, indexes in _chunks(records):
        _index_chunk(chunk, indexes)
    places, at = [], len(MAGIC)
    for record in records:
        places.append(at)
        at += len(record.packed())
    where = list(zip(records, places, [*places[1:], at], strict=True))
    for kind, index in _INDEXED.items():
        spans = [(start, end) for record, start, end in where if record.opcode == kind]
        for record, (start, end) in zip([r for r in records if r.opcode == index], spans, strict=False):
            _state(record, offset=start, length=end - start)
    summary = next((end for record, _, end in where if record.opcode == Opcode.DATA_END), 0)
    offsets = next((start for record, start, _ in where if record.opcode == Opcode.SUMMARY_OFFSET), 0)
    for record in records:
        if record.opcode == Opcode.FOOTER and record.fields["summary_start"]:
            _state(record, summary_start=summary, summary_offset_start=offsets)


def _state(record: Record, **values: int) -> None:
    record.fields |= {name: value for name, value in values.items() if name not in record.held}


def _chunks(records: list[Record]) -> list[tuple[Record, list[Record]]]:
    """Every chunk with its message indexes."""
    found: list[tuple[Record, list[Record]]] = []
    for record in records:
        if record.opcode == Opcode.CHUNK:
            found.append((record, []))
        elif record.opcode == Opcode.MESSAGE_INDEX and found:
            found[-1][1].append(record)
    return found


def _index_chunk(chunk: Record, indexes: list[Record]) -> None:
    entries: dict[int, bytes] = {}
    at = 0
    for record in chunk.inner or ():
        if record.opcode == Opcode.MESSAGE:
            entry = struct.pack("<QQ", record.fields["log_time"] % 2**64, at)
            entries[record.fields["channel_id"]] = entries.get(record.fields["channel_id"], b"") + entry
        at += len(record.packed())
    times = [r.fields["log_time"] for r in chunk.inner or () if r.opcode == Opcode.MESSAGE] or [0]
    _state(chunk, start=min(times), end=max(times))
    for index in indexes:
        if "records" not in index.held:
            index.fields["records"] = entries.get(index.fields["channel_id"], b"")


def mutate_records(records: list[Record], choices: Choices) -> None:
    """Change one record in place, inside or outside a chunk."""
    if not records:
        return
    chunks = [record.inner for record in records if record.inner]
    scope = chunks[choices.index("chunk", len(chunks))] if chunks and choices.chance("inside", 0.4) else records
    kinds = sorted({record.opcode for record in scope})
    kind = choices.of("kind", kinds)
    places = [k for k, record in enumerate(scope) if record.opcode == kind] or [0]
    at = places[choices.index("record", len(places))]
    FAULTS[choices.of("do", WEIGHTED)](scope, at, choices)


def _field(scope: list[Record], at: int, choices: Choices) -> None:
    record, kinds = scope[at], dict(LAYOUTS.get(scope[at].opcode, ()))
    name = choices.of("field", tuple(kinds) or ("",))
    kind = kinds.get(name)
    if kind is None:
        return
    record.held.add(name)
    if kind == "s":
        record.fields[name] = wild_text(choices).encode("utf-8", "surrogatepass")
    elif kind in "dDr":
        record.fields[name] = damage(record.fields[name], choices)
    else:
        near = record.fields[name] + choices.of("by", (-9, -1, 1, 8, 9, 100))
        record.fields[name] = near if choices.chance("near", 0.3) else wild_integer(choices)


def _length(scope: list[Record], at: int, choices: Choices) -> None:
    scope[at].length = wild_integer(choices) % 2**64


def _inner_length(scope: list[Record], at: int, choices: Choices) -> None:
    names = [name for name, kind in LAYOUTS.get(scope[at].opcode, ()) if kind in _LENGTHS]
    if names:
        scope[at].lies[choices.of("field", names)] = wild_integer(choices)


def _repeat(scope: list[Record], at: int, choices: Choices) -> None:
    scope[at:at] = [scope[at]] * choices.of("copies", (1, 2, 300))


def _bomb(scope: list[Record], at: int, choices: Choices) -> None:
    """A chunk of few bytes that decompress to many zeros; its header declares that size or a small one."""
    record = scope[at]
    if record.opcode == Opcode.CHUNK:
        size = choices.of("unpacked", (10**7, 3 * 10**9, 10**11))
        record.fields |= {"compression": b"zstd", "records": zeros_as_zstd(size)}
        record.fields["size"] = choices.of("stated", (size, record.fields["size"]))
        record.held |= {"compression", "records", "size", "crc"}
        record.fields["crc"] = 0


def zeros_as_zstd(size: int, *, stated: bool = True) -> bytes:
    """A zstd frame of `size` zeros, in blocks of 128 kB (RFC 8878); with `stated` its header declares the size."""
    block = 128 * 1024
    count = -(-size // block)
    blocks = bytearray(struct.pack("<I", (block << 3) | 0b010)[:3] + b"\0") * (count - 1)
    last = size - (count - 1) * block
    blocks += struct.pack("<I", (last << 3) | 0b011)[:3] + b"\0"
    head = struct.pack("<IBB", 0xFD2FB528, 0b11000000 if stated else 0, 0b01101000)
    return head + (struct.pack("<Q", size) if stated else b"") + bytes(blocks)


FAULTS: dict[str, Callable[[list[Record], int, Choices], object]] = {
    "bomb": _bomb, "field": _field, "length": _length, "inner_length": _inner_length,
    "repeat": _repeat,
    "remove": lambda scope, at, _: scope.pop(at),
    "move": lambda scope, at, choices: scope.insert(choices.index("to", len(scope)), scope.pop(at)),
    "garbage": lambda scope, at, c: scope.insert(at, Record(0x90, {"data": bytes(c.of("bytes", (0, 1, 8, 9, 5000)))})),
}  # fmt: skip
WEIGHTED = ("field",) * 8 + tuple(FAULTS)
