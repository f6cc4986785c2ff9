"""Reading all that can be read of a log, in the order of the file, whatever happened to it.

A file that is cut is read up to the cut. A chunk that is damaged is left out, and where a record's length makes no
sense reading goes on at the next chunk the index names.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from zstandard import ZstdError

from roadperc_stream.errors import LogError
from roadperc_stream.log.framing import Damage, Framing, Record
from roadperc_stream.log.integrity import require_log, unopened
from roadperc_stream.log.limits import check_chunk
from roadperc_stream.log.reading import channel_of, usable_index
from roadperc_stream.log.records import Attachment, Channel, Message, Metadata

_MESSAGE_HEAD_BYTES: Final = 22
_UNREADABLE: Final = (
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
"""What the library and its decompressors throw at bytes that make no sense."""
_NOTED: Final[dict[int, Any]] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.METADATA: records.Metadata,
    Opcode.STATISTICS: records.Statistics,
}


@dataclass
class Salvage:
    """Reads a log once and keeps account of its state: complete when ``messages`` has come to its end.

    Raises:
        LogError: the file cannot be opened, is empty, or does not start as an MCAP log.
    """

    path: Path
    size_bytes: int = 0
    profile: str = ""
    library: str = ""
    chunks: Counter[str] = field(default_factory=Counter)
    """Chunks by their compression, empty for none."""
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    """Messages read, by ``Channel.source_id``."""
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    absent: tuple[str, ...] = ()
    """What a log may do without, and this one does: its index, CRCs."""
    last_good_ns: int | None = None
    """Log time of the last message before the first damage."""

    def __post_init__(self) -> None:
        try:
            self.size_bytes = self.path.stat().st_size
            with self.path.open("rb") as stream:
                require_log(self.path, stream)
                self._index = _index_of(stream)
        except OSError as error:
            raise unopened(self.path, error) from error
        self._schemas: dict[int, records.Schema] = {}
        self._statistics: records.Statistics | None = None
        self._chunks_without_crc = 0
        chunk_starts: list[int] = []
        if self._index is not None:
            chunk_starts = sorted(chunk.chunk_start_offset for chunk in self._index.chunk_indexes)
            self._schemas |= self._index.schemas
            for channel in self._index.channels.values():
                self._know(channel)
        self._framing = Framing(self.size_bytes, chunk_starts)

    @property
    def damages(self) -> list[Damage]:
        """Where the file is not what it should be, in its order."""
        return self._framing.damages

    @property
    def whole(self) -> bool:
        """Whether everything that was written is there, as far as the file lets anybody know."""
        return self._framing.ended and not self.damages

    @property
    def indexed_channels(self) -> tuple[Channel, ...] | None:
        """The channels that hold messages, by the index; None where there is no usable one."""
        if self._index is None or self._index.statistics is None:
            return None
        counts = self._index.statistics.channel_message_counts
        return tuple(self.channels[i] for i in sorted(self.channels) if counts.get(i))

    def messages(self) -> Iterator[Message]:
        """Every message that can be read, in the order of the file."""
        try:
            with self.path.open("rb") as stream:
                for record in self._framing.records(stream):
                    yield from self._messages_of(record)
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        self._conclude()

    def _messages_of(self, record: Record) -> Iterator[Message]:
        """The messages of a record: one, a chunk's, or none of any other, which is taken note of."""
        try:
            contents = self._contents(record)
        except _UNREADABLE as error:
            self._framing.damaged(record.start, f"{record.name}: {_in_words(error)}")
            return
        for item in contents:
            if not isinstance(item, records.Message):
                self._note(item)
            elif item.channel_id in self.channels:
                yield self._counted(item)
            else:
                words = f"{record.name}: message of channel {item.channel_id}, which nothing describes"
                self._framing.damaged(record.start, words)

    def _contents(self, record: Record) -> list[records.McapRecord]:
        stream = ReadDataStream(BytesIO(record.body))
        if record.opcode == Opcode.CHUNK:
            check_chunk(BytesIO(record.body))
            chunk = records.Chunk.read(stream)
            self.chunks[chunk.compression] += 1
            self._chunks_without_crc += not chunk.uncompressed_crc
            return breakup_chunk(chunk, validate_crc=True)
        if record.opcode == Opcode.MESSAGE:
            if len(record.body) < _MESSAGE_HEAD_BYTES:
                raise EndOfFile
            return [records.Message.read(stream, len(record.body))]
        return [_NOTED[record.opcode].read(stream)] if record.opcode in _NOTED else []

    def _counted(self, message: records.Message) -> Message:
        self.counts[message.channel_id] += 1
        if not self.damages:
            self.last_good_ns = message.log_time
        channel = self.channels[message.channel_id]
        return Message(channel, message.log_time, message.publish_time, message.sequence, message.data)

    def _note(self, item: records.McapRecord) -> None:
        """Keep what a record other than a message says."""
        match item:
            case records.Header():
                self.profile, self.library = item.profile, item.library
            case records.Schema():
                self._schemas[item.id] = item
            case records.Channel():
                self._know(item)
            case records.Attachment():
                self.attachments.append(
                    Attachment(item.name, item.media_type, item.data, item.log_time, item.create_time)
                )
            case records.Metadata():
                self.metadata.append(Metadata(item.name, tuple(sorted(item.metadata.items()))))
            case records.Statistics():
                self._statistics = item

    def _know(self, channel: records.Channel) -> None:
        self.channels[channel.id] = channel_of(channel, self._schemas.get(channel.schema_id))

    def _conclude(self) -> None:
        """What only the end shows: records that fell out without a trace, and what the writer left out."""
        statistics, found = self._statistics, self.counts.total()
        if statistics is not None and statistics.message_count != found and not self.damages:
            words = f"{found} messages found, the statistics count {statistics.message_count}"
            self._framing.damaged(self.size_bytes, words)
        lacking = {
            "index": self._index is None,
            "CRC of the data section": not self._framing.sealed,
            f"CRCs of {self._chunks_without_crc} chunks": bool(self._chunks_without_crc),
        }
        self.absent = tuple(what for what, true in lacking.items() if true)


def _index_of(stream: IO[bytes]) -> Summary | None:
    """The index, where there is one that can be used; None where the file's end is missing or makes no sense."""
    stream.seek(0)
    try:
        return usable_index(make_reader(stream))
    except (OSError, *_UNREADABLE):  # a seek before the start is an OSError; one of the disk comes again in reading
        return None


def _in_words(error: BaseException) -> str:
    if isinstance(error, EndOfFile):
        return "ends before its contents do"
    return " ".join(str(error).split()) or type(error).__name__
