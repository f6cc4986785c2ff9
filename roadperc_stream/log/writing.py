"""Logs out: a file appears under its name only when complete."""

import os
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap.writer import CompressionType, Writer

from roadperc_stream import __version__
from roadperc_stream.core.files import partial_of, target_errors
from roadperc_stream.log.growing import GrowingLog
from roadperc_stream.log.records import Attachment, Channel, Message, Metadata
from roadperc_stream.log.spool import storing

CHUNK_SIZE_BYTES = 1024 * 1024


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
    _growing: GrowingLog | None = None
    _end_byte: int = 0

    def __post_init__(self) -> None:
        self._temporary = partial_of(self.path)

    def __enter__(self) -> Self:
        with self._errors():
            self._stream = self._open()
        self._writer = Writer(
            self._stream,
            chunk_size=CHUNK_SIZE_BYTES,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._writer.start(profile=self.profile, library=f"roadperc_stream {__version__}")
        return self

    def _open(self) -> IO[bytes]:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        return self._temporary.open("wb")

    def _errors(self) -> AbstractContextManager[None]:
        return target_errors(self.path)

    def write(self, message: Message) -> None:
        """Append a message; its channel and schema are registered at their first use.

        Raises:
            TargetError: it cannot be written, as when the disk is full; so with all that is added to a log.
        """
        self.register(message.channel)
        self.messages += 1
        with self._errors():
            self._writer.add_message(
                channel_id=self._channel_ids[message.channel],
                log_time=message.log_time_ns,
                data=message.data,
                publish_time=message.publish_time_ns,
                sequence=message.sequence,
            )
        if self._growing is not None:
            self._growing.append(self._channel_ids[message.channel], message)
            self._note_chunk(self._growing)

    def while_written(self) -> GrowingLog:
        """The log for a reader in another thread, from now to the end; before the first message.

        What is written stays the same, byte for byte.
        """
        assert not self.messages
        self._growing, self._end_byte = GrowingLog(self._temporary, tuple(self._channel_ids)), self._stream.tell()
        return self._growing

    def _note_chunk(self, growing: GrowingLog) -> None:
        """The library writes to the file only whole chunks: where the file has grown, one was closed."""
        end_byte = self._stream.tell()
        if end_byte > self._end_byte:
            self._stream.flush()
            growing.close_chunk(self._end_byte, end_byte)
        self._end_byte = end_byte

    def register(self, channel: Channel) -> None:
        """Make a channel known, also where it never gets a message."""
        if channel in self._channel_ids:
            return
        schema = (channel.schema_name, channel.schema_encoding, channel.schema_data)
        if any(schema) and schema not in self._schema_ids:
            self._schema_ids[schema] = self._writer.register_schema(
                name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema_data
            )
        self._channel_ids[channel] = self._writer.register_channel(
            topic=channel.topic,
            message_encoding=channel.message_encoding,
            schema_id=self._schema_ids.get(schema, 0),
            metadata=dict(channel.metadata),
        )
        if self._growing is not None:
            self._note_chunk(self._growing)

    def attach(self, attachment: Attachment) -> None:
        """Add an attachment."""
        with self._errors():
            self._writer.add_attachment(
                create_time=attachment.create_time_ns,
                log_time=attachment.log_time_ns,
                name=attachment.name,
                media_type=attachment.media_type,
                data=attachment.data,
            )
        self._end_byte = self._stream.tell()

    def describe(self, metadata: Metadata) -> None:
        """Add a metadata record."""
        with self._errors():
            self._writer.add_metadata(metadata.name, dict(metadata.values))
        self._end_byte = self._stream.tell()

    def complete(self) -> None:
        """Write what is still to be written: then nothing is left but to give the file its name.

        Raises:
            TargetError: it cannot be written.
        """
        if not self._stream.closed:
            with self._errors():
                self._writer.finish()  # type: ignore[no-untyped-call]
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
        else:
            self._temporary.replace(self.path)

    def discard(self) -> None:
        """Remove what is not complete."""
        self._temporary.unlink(missing_ok=True)


@dataclass
class StoredLogWriter(LogWriter):
    """Writes a log to a file without a name, which its caller keeps: ``path`` is what errors call it."""

    file: IO[bytes] = field(kw_only=True)

    def _open(self) -> IO[bytes]:
        return os.fdopen(os.dup(self.file.fileno()), "wb")

    def _errors(self) -> AbstractContextManager[None]:
        return storing(str(self.path))

    def _name(self) -> None:
        """It gets none."""

    def discard(self) -> None:
        """It is gone with the file."""
