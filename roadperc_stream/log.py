"""Reading and writing MCAP files: the only module that imports mcap.

Bytes in, bytes out; what they mean is the business of ``channels``.
"""

import hashlib
import os
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Channel as McapChannel
from mcap.records import Schema as McapSchema
from mcap.writer import CompressionType, Writer
from zstandard import ZstdError

from roadperc_stream import __version__
from roadperc_stream.errors import LogError

CHUNK_SIZE_BYTES = 1024 * 1024
MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class Channel:
    """A channel with its schema: two with equal fields are one channel in a log written here."""

    topic: str
    message_encoding: str
    schema_name: str = ""
    schema_encoding: str = ""
    schema_data: bytes = b""
    metadata: tuple[tuple[str, str], ...] = ()
    source_id: int = 0
    """Channel id in the file it was read from, so that twins stay apart."""

    def label(self, key: str) -> str:
        """Value of a metadata key, empty where there is none."""
        return dict(self.metadata).get(key, "")


@dataclass(frozen=True)
class Message:
    """One message as it stands in a file."""

    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True)
class Attachment:
    """A file carried inside a log."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int = 0
    create_time_ns: int = 0


@dataclass(frozen=True)
class Metadata:
    """A named record of strings."""

    name: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class LogSummary:
    """What a log holds, without its messages."""

    path: Path
    profile: str
    channels: tuple[Channel, ...]
    counts: Mapping[int, int]
    """Messages per ``Channel.source_id``."""
    attachments: tuple[Attachment, ...] = ()
    metadata: tuple[Metadata, ...] = ()
    first_ns: int | None = None
    last_ns: int | None = None


@contextmanager
def _reading(path: Path, validate_crcs: bool) -> Iterator[McapReader]:
    """Open a log; everything the file or the library can throw becomes one LogError that names the file."""
    try:
        with path.open("rb") as stream:
            _require_whole(path, stream)
            yield make_reader(stream, validate_crcs=validate_crcs)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    except McapError as error:
        raise LogError(f"{path}: damaged MCAP: {error}") from error
    except (EOFError, ValueError, KeyError, OverflowError, MemoryError, RuntimeError, struct.error, ZstdError) as error:
        raise LogError(f"{path}: damaged MCAP: {type(error).__name__}: {error}") from error


def _require_whole(path: Path, stream: IO[bytes]) -> None:
    """Tell an empty, a foreign and a cut file apart: the library's own words do not."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    if size == 0:
        raise LogError(f"{path}: empty file, expected an MCAP log")
    if stream.read(len(MAGIC)) != MAGIC:
        raise LogError(f"{path}: not an MCAP log (it does not start with the MCAP magic)")
    stream.seek(max(size - len(MAGIC), 0))
    if stream.read(len(MAGIC)) != MAGIC or size < 2 * len(MAGIC):
        raise LogError(f"{path}: cut off: the MCAP footer is missing after {size} bytes")
    stream.seek(0)


def summarise(path: Path) -> LogSummary:
    """Channels, counts, attachments and metadata of a log, from its index where it has one.

    Raises:
        LogError: the file cannot be read, is no MCAP, is cut or damaged.
    """
    with _reading(path, validate_crcs=True) as reader:
        profile = reader.get_header().profile
        attachments = tuple(
            Attachment(a.name, a.media_type, a.data, a.log_time, a.create_time) for a in reader.iter_attachments()
        )
        metadata = tuple(Metadata(m.name, tuple(sorted(m.metadata.items()))) for m in reader.iter_metadata())
        index = reader.get_summary()
        if index is not None and index.statistics is not None and index.chunk_indexes:
            channels = tuple(
                _channel(index.channels[i], index.schemas.get(index.channels[i].schema_id))
                for i in sorted(index.channels)
            )
            counts = dict(index.statistics.channel_message_counts)
            first, last = index.statistics.message_start_time, index.statistics.message_end_time
            return LogSummary(path, profile, channels, counts, attachments, metadata, first, last)
    return _scan(path, profile, attachments, metadata)


def _scan(path: Path, profile: str, attachments: tuple[Attachment, ...], metadata: tuple[Metadata, ...]) -> LogSummary:
    """The summary of a log without an index, by reading it."""
    channels: dict[int, Channel] = {}
    counts: Counter[int] = Counter()
    first = last = None
    for message in read(path):
        source = message.channel.source_id
        channels.setdefault(source, message.channel)
        counts[source] += 1
        first = message.log_time_ns if first is None else first
        last = message.log_time_ns
    ordered = tuple(channels[source] for source in sorted(channels))
    return LogSummary(path, profile, ordered, counts, attachments, metadata, first, last)


def _channel(channel: McapChannel, schema: McapSchema | None) -> Channel:
    return Channel(
        channel.topic,
        channel.message_encoding,
        schema.name if schema else "",
        schema.encoding if schema else "",
        schema.data if schema else b"",
        tuple(sorted(channel.metadata.items())),
        channel.id,
    )


def read(
    path: Path,
    *,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
    validate_crcs: bool = False,
) -> Iterator[Message]:
    """Messages in the order of their log time; those of equal time in the order of the file.

    Args:
        path: the log.
        topics: only these; None for all.
        start_ns: first log time read.
        end_ns: first log time no longer read.
        validate_crcs: check every chunk; a pass over the whole file needs it once.

    Raises:
        LogError: the file cannot be read, is no MCAP, is cut or damaged.

    """
    known: dict[int, Channel] = {}
    with _reading(path, validate_crcs) as reader:
        for schema, channel, message in reader.iter_messages(
            topics=None if topics is None else list(topics), starting_at=start_ns, ending_before=end_ns
        ):
            if channel.id not in known:
                known[channel.id] = _channel(channel, schema)
            yield Message(known[channel.id], message.log_time, message.publish_time, message.sequence, message.data)


class MessageDigest:
    """Digest over messages: topic, schema, times, sequence and bytes, in the order they come."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def update(self, message: Message) -> None:
        """Take one more message."""
        head = f"{message.channel.topic}\0{message.channel.schema_name}\0{message.log_time_ns}\0"
        head += f"{message.publish_time_ns}\0{message.sequence}\0{len(message.data)}\0"
        self._hash.update(head.encode())
        self._hash.update(message.data)

    def hexdigest(self) -> str:
        """64 hexadecimal digits."""
        return self._hash.hexdigest()


@dataclass
class LogWriter:
    """Writes a log whose file appears under its name only when complete. Use it as a context manager.

    All CRCs are written; the bytes depend on nothing but what is written.
    """

    path: Path
    profile: str = ""
    messages: int = 0
    """Messages written so far."""
    _channel_ids: dict[Channel, int] = field(default_factory=dict)
    _schema_ids: dict[tuple[str, str, bytes], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}.partial")

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._temporary.open("wb")
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        self._writer = Writer(
            self._stream,
            chunk_size=CHUNK_SIZE_BYTES,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._writer.start(profile=self.profile, library=f"roadperc_stream {__version__}")
        return self

    def write(self, message: Message) -> None:
        """Append a message; its channel and schema are registered at their first use."""
        self.register(message.channel)
        self.messages += 1
        self._writer.add_message(
            channel_id=self._channel_ids[message.channel],
            log_time=message.log_time_ns,
            data=message.data,
            publish_time=message.publish_time_ns,
            sequence=message.sequence,
        )

    def register(self, channel: Channel) -> None:
        """Make a channel known, also where it never gets a message."""
        if channel in self._channel_ids:
            return
        schema = (channel.schema_name, channel.schema_encoding, channel.schema_data)
        if channel.schema_name and schema not in self._schema_ids:
            self._schema_ids[schema] = self._writer.register_schema(
                name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema_data
            )
        self._channel_ids[channel] = self._writer.register_channel(
            topic=channel.topic,
            message_encoding=channel.message_encoding,
            schema_id=self._schema_ids.get(schema, 0),
            metadata=dict(channel.metadata),
        )

    def attach(self, attachment: Attachment) -> None:
        """Add an attachment."""
        self._writer.add_attachment(
            create_time=attachment.create_time_ns,
            log_time=attachment.log_time_ns,
            name=attachment.name,
            media_type=attachment.media_type,
            data=attachment.data,
        )

    def describe(self, metadata: Metadata) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(metadata.name, dict(metadata.values))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.close()
            if kind is None:
                self._temporary.replace(self.path)
        finally:
            self._temporary.unlink(missing_ok=True)
