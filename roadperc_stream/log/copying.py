"""Messages of one log into another, as far as other writing has come."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import chain
from typing import Final

from roadperc_stream.log.indexed import IndexedFile, Piece
from roadperc_stream.log.mcap_file import ChunkRecords
from roadperc_stream.log.parts import UnitedParts
from roadperc_stream.log.reading import IndexedOrSorted, read
from roadperc_stream.log.records import Channel, LogSummary
from roadperc_stream.log.writing import LogWriter

_UNKNOWN: Final[Mapping[int, int]] = {}


def pieces(
    summary: LogSummary, channels: Collection[Channel], start_ns: int | None, end_ns: int | None
) -> Iterator[Piece]:
    """The messages of some channels as ``read`` gives them, whole chunks of the file where nothing else is in them.

    Args:
        summary: of the log.
        channels: of it.
        start_ns: first log time read.
        end_ns: first log time no longer read.

    Raises:
        LogError: as ``read``.
        TargetError: as ``read``.
    """
    source, kept, topics = summary.source, frozenset(channels), {channel.topic for channel in channels}
    if isinstance(source, IndexedOrSorted):
        source = source.chosen(topics, start_ns, end_ns)
    if isinstance(source, UnitedParts) and source.in_turn:
        return chain.from_iterable(
            pieces(file, kept.intersection(file.channels), start_ns, end_ns) for file in source.in_turn
        )
    if isinstance(source, IndexedFile):
        return source.pieces(frozenset(channel.source_id for channel in kept), start_ns, end_ns)
    messages = read(summary, topics=topics, start_ns=start_ns, end_ns=end_ns)
    return (message for message in messages if message.channel in kept)


class MessageCopy:
    """Copies messages to a log that others write to as well: each stands there before what is written of its time.

    What is copied stands in chunks of its own, so that these are whole ones for who copies that log.
    """

    def __init__(
        self,
        writer: LogWriter,
        channels: Iterable[Channel],
        copied: Iterator[Piece],
        schema_ids: Mapping[int, int] = _UNKNOWN,
    ) -> None:
        """Register the channels, also those that never get a message.

        Args:
            writer: of the log to copy to, where no channel is registered yet: they keep their ids.
            channels: of the messages, and others to be there.
            copied: messages, and chunks, in the order of log time.
            schema_ids: of the channels' schemas, as ``LogSummary`` has them, which are kept as well.
        """
        self._writer, self._copied = writer, copied
        for channel in channels:
            writer.register(channel, ids=(channel.source_id, schema_ids.get(channel.source_id, 0)))
        self._next = next(copied, None)

    def through(self, log_time_ns: int | None) -> None:
        """Copy everything up to and including a log time, and the rest of its chunk; None copies all that is left."""
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
        """Copy all that is left."""
        self.through(None)

    def _is_due(self, log_time_ns: int | None) -> bool:
        piece = self._next
        if piece is None or log_time_ns is None:
            return piece is not None
        return (piece.span_ns[0] if isinstance(piece, ChunkRecords) else piece.log_time_ns) <= log_time_ns
