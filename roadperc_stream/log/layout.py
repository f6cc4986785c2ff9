"""The bytes of an MCAP file: iterates over records, and reads the fields of each kind.

The mcap library's readers copy the data, and report neither the position of a record nor its fault. Format:
https://mcap.dev/spec.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final, NamedTuple

from deflate import crc32
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from zstandard import ZstdError

from roadperc_stream.log.records import Channel, Message

MAGIC: Final = b"\x89MCAP0\r\n"
CRC_BYTES: Final = 4
RECORD: Final = struct.Struct("<BQ")
"""Start of every record: opcode, and length of the rest."""
MESSAGE: Final = struct.Struct("<HIQQ")
CHUNK: Final = struct.Struct("<QQQII")
LENGTH: Final = struct.Struct("<Q")
INDEX: Final = struct.Struct("<HI")
ENTRY: Final = struct.Struct("<QQ")
"""Entry of a message index: a message's log time and its offset in the chunk's data."""
COMPRESSIONS: Final = ("", "lz4", "zstd")
TOO_SHORT: Final = "ends before its contents do"
UNREADABLE: Final = (
    McapError,
    EOFError,
    ValueError,
    KeyError,
    OverflowError,
    RuntimeError,
    MemoryError,
    struct.error,
    ZstdError,
)
"""Errors that the mcap library and its decompressors raise for invalid bytes."""
NAMES: Final = {int(opcode): opcode.name.lower().replace("_", " ") for opcode in Opcode}
PARSED: Final[dict[int, Any]] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.METADATA: records.Metadata,
    Opcode.STATISTICS: records.Statistics,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.FOOTER: records.Footer,
}
"""The mcap library's classes for records that describe messages or the log."""


class Record(NamedTuple):
    """A record of a file or of a chunk's data, and the byte where it starts there."""

    start: int
    opcode: int
    body: bytes | memoryview

    @property
    def name(self) -> str:
        """The specification's name of this kind of record."""
        return NAMES.get(self.opcode, f"{self.opcode:#04x}")

    @property
    def end(self) -> int:
        """The byte behind it."""
        return self.start + RECORD.size + len(self.body)

    def crc(self, before: int, end: int | None = None) -> int:
        """Return the CRC ``before``, continued with this record, or with its body up to ``end``."""
        head = RECORD.pack(self.opcode, len(self.body))
        return crc32(memoryview(self.body)[:end], crc32(head, before))

    def number(self, at: int) -> int:
        """Return the 32-bit number at a byte of the body; 0 behind its end."""
        return int.from_bytes(self.body[at : at + CRC_BYTES], "little")


@dataclass(frozen=True)
class MessageHead:
    """A message record without its content."""

    channel_id: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int

    def of(self, channel: Channel, body: bytes | memoryview) -> Message:
        """Return the message of a record with these fields."""
        return Message(channel, self.log_time_ns, self.publish_time_ns, self.sequence, bytes(body[MESSAGE.size :]))


@dataclass(frozen=True)
class ChunkHead:
    """The fields of a chunk, and its records as stored in the file."""

    first_ns: int
    last_ns: int
    size_bytes: int
    crc: int
    compression: str
    stored_bytes: int
    """Declared length of the records in the file; ``stored`` is shorter if the file is cut."""
    stored: memoryview

    @property
    def record_bytes(self) -> int:
        """Length of the whole record according to these fields."""
        return RECORD.size + CHUNK.size + len(self.compression) + LENGTH.size + self.stored_bytes


def entry_of(head: ChunkHead, start: int, body_bytes: int) -> records.ChunkIndex:
    """Return the index entry of a chunk at byte ``start``, without its message indexes."""
    return records.ChunkIndex(
        chunk_length=RECORD.size + body_bytes,
        chunk_start_offset=start,
        compression=head.compression,
        compressed_size=head.stored_bytes,
        message_end_time=head.last_ns,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=head.first_ns,
        uncompressed_size=head.size_bytes,
    )


def records_in(data: bytes | memoryview) -> Iterator[Record]:
    """Yield the records of some bytes.

    Raises:
        ValueError: a record exceeds the bytes; those before it were yielded.
    """
    view, at = memoryview(data), 0
    while at < len(view):
        start = at + RECORD.size
        if start > len(view):
            raise ValueError(TOO_SHORT)
        opcode, length = RECORD.unpack_from(view, at)
        if length > len(view) - start:
            raise ValueError(f"a record of {length} bytes at its byte {at}, {len(view) - start} are left")
        yield Record(at, opcode, view[start : start + length])
        at = start + length


def chunk_of(record: bytes) -> ChunkHead:
    """Read the fields of a chunk from a whole record, as ``chunk_head`` from its body."""
    return chunk_head(memoryview(record)[RECORD.size :])


def chunk_head(body: bytes | memoryview) -> ChunkHead:
    """Read the fields of a chunk from a record's body.

    Raises:
        ValueError: they are not valid.
    """
    if len(body) < CHUNK.size:
        raise ValueError(TOO_SHORT)
    first_ns, last_ns, size_bytes, crc, name_bytes = CHUNK.unpack_from(body)
    start = CHUNK.size + name_bytes + LENGTH.size
    name = bytes(body[CHUNK.size : CHUNK.size + min(name_bytes, 8)]).decode("ascii", "replace")
    if name not in COMPRESSIONS or len(name) != name_bytes:
        raise ValueError(f"compression {name!r}, expected none, lz4 or zstd")
    if start > len(body):
        raise ValueError(TOO_SHORT)
    (stored_bytes,) = LENGTH.unpack_from(body, start - LENGTH.size)
    return ChunkHead(first_ns, last_ns, size_bytes, crc, name, stored_bytes, memoryview(body)[start:][:stored_bytes])


def message_head(body: bytes | memoryview) -> MessageHead:
    """Read the fields of a message, the first ``MESSAGE.size`` bytes of the record's body.

    Raises:
        ValueError: the body is shorter.
    """
    if len(body) < MESSAGE.size:
        raise ValueError(f"message {TOO_SHORT}")
    return MessageHead(*MESSAGE.unpack_from(body))


def message_index(body: bytes | memoryview) -> tuple[int, list[tuple[int, int]]]:
    """Return the channel of a message index, and log time and chunk offset of each message.

    Raises:
        ValueError: it is not valid.
    """
    if len(body) < INDEX.size:
        raise ValueError(TOO_SHORT)
    channel_id, length = INDEX.unpack_from(body)
    if length % ENTRY.size or INDEX.size + length > len(body):
        raise ValueError(TOO_SHORT)
    return channel_id, list(ENTRY.iter_unpack(memoryview(body)[INDEX.size :][:length]))


def parse(opcode: int, body: bytes) -> Any:
    """Read a record's fields with the mcap library; later versions of the format may add bytes behind them.

    Args:
        opcode: one of ``PARSED``.
        body: the record behind its length.

    Raises:
        EndOfFile: the body is too short for the fields.
        ValueError: the fields are not valid, or the CRC of an attachment is wrong.
    """
    stream = _Bounded(BytesIO(body))
    item = PARSED[opcode].read(stream)
    if opcode == Opcode.ATTACHMENT:
        end = stream.count - CRC_BYTES
        require_crc("attachment", crc32(memoryview(body)[:end]), int.from_bytes(body[end : stream.count], "little"))
    return item


def fault_of(error: BaseException) -> str:
    """Return the text of one of the errors ``UNREADABLE``."""
    words = TOO_SHORT if isinstance(error, EOFError | EndOfFile) else " ".join(str(error).split())
    return words or type(error).__name__


def require_crc(what: str, found: int, expected: int) -> None:
    """Compare a computed CRC with the written one; zero means that the writer did not compute one.

    Raises:
        ValueError: they differ.
    """
    if expected not in {0, found}:
        raise ValueError(f"CRC of the {what} is {found:#010x}, expected {expected:#010x}")


class _Bounded(ReadDataStream):
    """Reads a record's bytes; too few are an error."""

    def read(self, length: int) -> bytes:
        """Return exactly ``length`` bytes."""
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data
