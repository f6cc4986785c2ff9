"""The messages of a log as they stand in the file, one in memory at a time, however its writer arranged them.

The library holds the whole of each chunk, and a log may be a single one. Layout: https://mcap.dev/spec.
"""

import os
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from typing import IO, Any, Final

import lz4.frame
from deflate import crc32
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zstandard import ZstdDecompressor

from roadperc_stream.log.index import channel_of
from roadperc_stream.log.integrity import MAGIC
from roadperc_stream.log.records import Channel, Message

_HEAD: Final = struct.Struct("<BQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQII")
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_LENGTH: Final = struct.Struct("<Q")


def _zstd(stream: IO[bytes]) -> IO[bytes]:
    return BufferedReader(ZstdDecompressor().stream_reader(stream, read_across_frames=True))


_DECOMPRESSORS: Final[Mapping[str, Callable[[IO[bytes]], Any]]] = {
    "": lambda stream: stream,
    "zstd": _zstd,
    "lz4": lambda stream: lz4.frame.LZ4FrameFile(stream, mode="rb"),
}


class _Section:
    """A stream's next bytes: reads no further than they go, and sums them up."""

    def __init__(self, stream: IO[bytes], size_bytes: int) -> None:
        self._stream, self.left = stream, size_bytes
        self.crc = 0

    def read(self, size_bytes: int = -1) -> bytes:
        wanted = self.left if size_bytes < 0 else min(size_bytes, self.left)
        data = self._stream.read(wanted)
        self.left -= len(data)
        return data

    def exactly(self, size_bytes: int) -> bytes:
        """So many bytes, added to the CRC.

        Raises:
            McapError: there are fewer.
        """
        if size_bytes > self.left:
            raise McapError(f"a record of {size_bytes} bytes where {self.left} are left")
        data = self.read(size_bytes)
        if len(data) < size_bytes:
            raise McapError("a chunk ends before its contents do")
        self.crc = crc32(data, self.crc)
        return data


def _records(stream: IO[bytes]) -> Iterator[tuple[int, _Section]]:
    """The records outside chunks up to the footer, each to be read before the next is asked for, or not at all."""
    left = stream.seek(0, os.SEEK_END) - stream.seek(len(MAGIC))
    while left > 0:
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        left -= _HEAD.size + length
        if opcode == Opcode.FOOTER:
            return
        if left < 0:
            raise McapError(f"a record of {length} bytes where {left + length} are left")
        following = stream.tell() + length
        yield opcode, _Section(stream, length)
        stream.seek(following)


def attachments_and_metadata(stream: IO[bytes]) -> tuple[list[records.Attachment], list[records.Metadata]]:
    """What stands in a file besides its messages; nothing else is read.

    Args:
        stream: over the whole file.

    Raises:
        McapError: as ``FileOrder.messages``.
    """
    attachments, metadata = list[records.Attachment](), list[records.Metadata]()
    for opcode, body in _records(stream):
        if opcode == Opcode.ATTACHMENT:
            attachments.append(records.Attachment.read(ReadDataStream(BytesIO(body.exactly(body.left)))))
        elif opcode == Opcode.METADATA:
            metadata.append(records.Metadata.read(ReadDataStream(BytesIO(body.exactly(body.left)))))
    return attachments, metadata


@dataclass
class FileOrder:
    """Reads the messages of a log once, as they stand in the file. Every chunk's CRC is checked.

    ``channels`` is complete when that is done, those without messages included.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    """By ``Channel.source_id``."""
    _schemas: dict[int, records.Schema] = field(default_factory=dict)

    def messages(self, stream: IO[bytes]) -> Iterator[Message]:
        """Every message.

        Args:
            stream: over the whole file.

        Raises:
            McapError: the file is damaged; of bytes that make no sense others come as well, such as a ValueError.
        """
        for opcode, body in _records(stream):
            yield from self._messages_of(opcode, body)

    def _messages_of(self, opcode: int, body: _Section) -> Iterator[Message]:
        if opcode == Opcode.CHUNK:
            yield from self._messages_in(body)
        elif opcode == Opcode.MESSAGE:
            yield self._message(body.exactly(body.left))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._note(opcode, body.exactly(body.left))

    def _messages_in(self, chunk: _Section) -> Iterator[Message]:
        """The messages of a chunk."""
        _, _, size_bytes, expected, name_length = _CHUNK_HEAD.unpack(chunk.exactly(_CHUNK_HEAD.size))
        name = chunk.exactly(name_length).decode()
        if name not in _DECOMPRESSORS:
            raise McapError(f"unsupported compression type {name}")
        (stored_bytes,) = _LENGTH.unpack(chunk.exactly(_LENGTH.size))
        contents = _Section(_DECOMPRESSORS[name](_Section(chunk, stored_bytes)), size_bytes)  # type: ignore[arg-type]
        while contents.left:
            opcode, length = _HEAD.unpack(contents.exactly(_HEAD.size))
            body = contents.exactly(length)
            if opcode == Opcode.MESSAGE:
                yield self._message(body)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._note(opcode, body)
        if expected and contents.crc != expected:
            raise McapError(f"crc validation failed in Chunk, expected: {expected}, calculated: {contents.crc}")

    def _message(self, body: bytes) -> Message:
        channel_id, sequence, log_time_ns, publish_time_ns = _MESSAGE_HEAD.unpack_from(body)
        if channel_id not in self.channels:
            raise McapError(f"no channel record found with id {channel_id}")
        data = body[_MESSAGE_HEAD.size :]
        return Message(self.channels[channel_id], log_time_ns, publish_time_ns, sequence, data)

    def _note(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(stream)
            self._schemas[schema.id] = schema
            return
        channel = records.Channel.read(stream)
        if channel.schema_id and channel.schema_id not in self._schemas:
            raise McapError(f"no schema record found with id {channel.schema_id}")
        self.channels.setdefault(channel.id, channel_of(channel, self._schemas.get(channel.schema_id)))
