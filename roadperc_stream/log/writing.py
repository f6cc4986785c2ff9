"""Writes logs, and copies messages of other logs into them. A file gets its name only when it is complete."""

import os
from collections.abc import Collection, Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

from mcap import records

from roadperc_stream import __version__
from roadperc_stream.errors import TargetError
from roadperc_stream.log.growing import GrowingLog
from roadperc_stream.log.mcap_file import ChunkRecords, McapFile, OpenChunk, Piece
from roadperc_stream.log.records import Attachment, Channel, Message, Metadata
from roadperc_stream.log.stored import storing
from roadperc_stream.system.files import partial_of, remove_stale_partials, target_errors

CHUNK_SIZE_BYTES = 1024 * 1024
_IDS: Final = 65535
"""Largest id of a channel or schema."""


@dataclass
class LogWriter:
    """Writes a log whose file appears under its name only when complete. Use it as a context manager.

    All CRCs are written. The bytes depend only on the content.
    """

    path: Path
    profile: str = ""
    library: str = f"roadperc_stream {__version__}"
    """The program in the header."""
    file: IO[bytes] | None = field(default=None, kw_only=True)
    """An unnamed file of the caller to write to; ``path`` is then only its name in errors."""
    _channel_ids: dict[Channel, int] = field(default_factory=dict)
    _schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    """Name, encoding and data, by their ids."""
    _growing: GrowingLog | None = None

    def __post_init__(self) -> None:
        self._temporary = partial_of(self.path)
        self._chunk = OpenChunk()

    def __enter__(self) -> Self:
        with self._errors():
            self._stream = self._open()
            self._file = McapFile(self._stream, self.profile, self.library)
        return self

    def _open(self) -> IO[bytes]:
        if self.file is not None:
            return os.fdopen(os.dup(self.file.fileno()), "wb")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        remove_stale_partials(self.path)
        return self._temporary.open("wb")

    @property
    def messages(self) -> int:
        """Number of messages in the written chunks."""
        return self._file.counts.total()

    def _errors(self) -> AbstractContextManager[None]:
        return storing(str(self.path)) if self.file is not None else target_errors(self.path)

    def write(self, message: Message) -> None:
        """Append a message; its channel and schema are registered at their first use.

        Raises:
            TargetError: the log cannot be written, for example on a full disk; the other methods raise it too.
        """
        channel_id = self.register(message.channel)
        self._chunk.add(channel_id, message)
        if self._growing is not None:
            self._growing.append(message)
        if self._chunk.size_bytes > CHUNK_SIZE_BYTES:
            self.end_chunk()

    def end_chunk(self) -> None:
        """End the open chunk; later messages go to the next one."""
        if not self._chunk.size_bytes:
            return
        finished, self._chunk = self._chunk.records(), OpenChunk()
        self._add_chunk(finished)

    def write_chunk(self, chunk: ChunkRecords, reached_ns: int | None) -> None:
        """Append a chunk of another log unchanged; its channels are registered with their ids in that log.

        ``reached_ns`` is the log time up to which all messages except results are written; None without an end.
        """
        self.end_chunk()
        self._add_chunk(chunk)
        if self._growing is not None:
            last_ns = chunk.head.last_ns
            self._growing.reach(last_ns if reached_ns is None else min(reached_ns, last_ns))

    def _add_chunk(self, chunk: ChunkRecords) -> None:
        with self._errors():
            entry = self._file.add_chunk(chunk)
            if self._growing is not None:
                self._stream.flush()
                self._growing.add_chunk(entry)

    def while_written(self) -> GrowingLog:
        """Return the log for a reader in another thread; call it before the first message.

        The file's bytes do not depend on it.
        """
        assert not self.messages
        self._growing = GrowingLog(self._temporary, {number: c for c, number in self._channel_ids.items()})
        return self._growing

    def register(self, channel: Channel, *, keep_ids: bool = False) -> int:
        """Describe a channel, even if it never gets a message, and return its id.

        ``keep_ids`` prefers the ids that the channel and its schema have in the source file.
        """
        known = self._channel_ids.get(channel)
        if known is not None:
            return known
        schema_id = self._schema_id(channel, channel.schema_id if keep_ids else 0)
        channel_id = self._free_id(self._channel_ids.values(), channel.source_id if keep_ids else None)
        with self._errors():
            self._file.add_channel(
                records.Channel(channel_id, channel.topic, channel.message_encoding, dict(channel.metadata), schema_id)
            )
        self._channel_ids[channel] = channel_id
        if self._growing is not None:
            self._growing.add_channel(channel_id, channel)
        return channel_id

    def _schema_id(self, channel: Channel, wanted: int) -> int:
        """Describe a channel's schema and return its id, the preferred one if free; 0 without a schema."""
        schema = channel.schema
        if not wanted and not any(schema):
            return 0
        if self._schemas.get(wanted) == schema:
            return wanted
        if not wanted and (known := next((i for i, s in self._schemas.items() if s == schema), None)) is not None:
            return known
        schema_id = self._free_id(self._schemas, wanted or None)
        with self._errors():
            name, encoding, data = schema
            self._file.add_schema(records.Schema(schema_id, data, encoding, name))
        self._schemas[schema_id] = schema
        return schema_id

    def _free_id(self, used: Collection[int], wanted: int | None) -> int:
        """Return the preferred id if free, else the next one after all others, else the first free one."""
        if wanted is not None and wanted not in used:
            return wanted
        ids = chain(range(max(used, default=0) + 1, _IDS + 1), range(1, _IDS + 1))
        found = next((i for i in ids if i not in used), None)
        if found is None:
            raise TargetError(f"{self.path}: more than {_IDS} channels or schemas")
        return found

    def attach(self, attachment: Attachment) -> None:
        """Add an attachment."""
        self.end_chunk()
        with self._errors():
            times_ns = attachment.create_time_ns, attachment.log_time_ns
            item = records.Attachment(*times_ns, attachment.name, attachment.media_type, attachment.data)
            self._file.add_attachment(item)

    def describe(self, metadata: Metadata) -> None:
        """Add a metadata record."""
        self.end_chunk()
        with self._errors():
            self._file.add_metadata(records.Metadata(name=metadata.name, metadata=dict(metadata.values)))

    def complete(self) -> None:
        """Write the open chunk and the index, so that only the renaming remains.

        Raises:
            TargetError: it cannot be written.
        """
        if not self._stream.closed:
            self.end_chunk()
            with self._errors():
                self._file.finish()
                self._stream.close()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.complete()
                with self._errors():
                    self._name()
        finally:
            with suppress(OSError):  # closing flushes, and a full disk fails again
                self._stream.close()
            self.discard()

    def _name(self) -> None:
        if self._growing is not None:
            self._growing.finish(self._temporary, self.path)
        elif self.file is None:
            self._temporary.replace(self.path)

    def discard(self) -> None:
        """Remove the partial file, if it can be removed."""
        if self.file is None:
            with suppress(OSError):
                self._temporary.unlink(missing_ok=True)


class MessageCopy:
    """Copies messages to a log that also gets results: a copied message comes before results of the same log time.

    Copied messages are in separate chunks, so that a later copy of this log can take these chunks unchanged.
    """

    def __init__(self, writer: LogWriter, channels: Iterable[Channel], copied: Iterator[Piece]) -> None:
        """Register the channels, also those that never get a message.

        Args:
            writer: of the target log. It has no channels yet, so the copied ones keep their ids.
            channels: of the messages, and others to register.
            copied: messages and chunks in log-time order.
        """
        self._writer, self._copied = writer, copied
        for channel in channels:
            writer.register(channel, keep_ids=True)
        self._next = next(copied, None)

    def through(self, log_time_ns: int | None) -> None:
        """Copy everything up to and including a log time, and the rest of its chunk; None copies the rest."""
        if not self._is_due(log_time_ns):
            return
        self._writer.end_chunk()
        while (piece := self._next) is not None and self._is_due(log_time_ns):
            if isinstance(piece, ChunkRecords):
                self._writer.write_chunk(piece, log_time_ns)
            else:
                self._writer.write(piece)
            self._next = next(self._copied, None)
        self._writer.end_chunk()

    def rest(self) -> None:
        """Copy the rest."""
        self.through(None)

    def _is_due(self, log_time_ns: int | None) -> bool:
        piece = self._next
        if piece is None or log_time_ns is None:
            return piece is not None
        return (piece.head.first_ns if isinstance(piece, ChunkRecords) else piece.log_time_ns) <= log_time_ns
