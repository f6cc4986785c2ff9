"""The contents of a log as types independent of the mcap library, and the digest of its messages."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from blake3 import blake3

RECOVERY_RECORD: Final = "roadperc.recovery"
"""Name of a repaired log's metadata record that lists what was lost."""
DIGEST_ALGORITHM: Final = "blake3"
"""BLAKE3 takes a quarter of the time of SHA-256, even with the processor's SHA instructions."""


@dataclass(frozen=True)
class Channel:
    """A channel with its schema. A written log has one channel for all with equal fields."""

    topic: str
    message_encoding: str
    schema_name: str = ""
    schema_encoding: str = ""
    schema_data: bytes = b""
    metadata: tuple[tuple[str, str], ...] = ()
    source_id: int = 0
    """Channel id in the source file; it distinguishes channels that are otherwise equal."""
    schema_id: int = field(default=0, compare=False)
    """Id of the schema in the source file, 0 if unknown."""

    @property
    def schema(self) -> tuple[str, str, bytes]:
        """Name, encoding and data of its schema."""
        return self.schema_name, self.schema_encoding, self.schema_data

    def label(self, key: str) -> str:
        """Return the value of a metadata key; empty if it is not set."""
        return dict(self.metadata).get(key, "")


@dataclass(frozen=True)
class Message:
    """One message, with its bytes as stored."""

    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True)
class Attachment:
    """A file stored inside a log."""

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


class MessageSource(Protocol):
    """Reads the messages of a log."""

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """Yield messages as ``reading.read`` does."""
        ...


@dataclass(frozen=True)
class LogSummary:
    """The contents of a log except messages, which ``source`` reads."""

    path: Path
    """The log's name in messages to the user."""
    source: MessageSource
    profile: str
    channels: tuple[Channel, ...]
    counts: Mapping[int, int]
    """Number of messages by ``Channel.source_id``."""
    attachments: tuple[Attachment, ...] = ()
    metadata: tuple[Metadata, ...] = ()
    first_ns: int | None = None
    last_ns: int | None = None
    files: tuple["LogSummary", ...] = ()
    """The files of a log in several files, in the order of their times; empty for a single file."""
    repeats: int = 0
    """For one of several files: number of its messages that an earlier file also has. These count once."""


class MessageDigest:
    """Digest of messages in order: topic, schema, times, sequence and bytes."""

    def __init__(self) -> None:
        self._hash = blake3()

    def update(self, message: Message) -> None:
        """Add a message."""
        head = f"{message.channel.topic}\0{message.channel.schema_name}\0{message.log_time_ns}\0"
        head += f"{message.publish_time_ns}\0{message.sequence}\0{len(message.data)}\0"
        self._hash.update(head.encode())
        self._hash.update(message.data)

    def hexdigest(self) -> str:
        """Return the digest as 64 hexadecimal digits."""
        return str(self._hash.hexdigest())
