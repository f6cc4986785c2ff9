"""Reads a log: its summary, and its messages in log-time order.

Chunks are read by the index that the check of the file made. A log with messages outside chunks, or with large
overlapping chunks, is sorted on disk.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.files import UnitedFiles, united
from roadperc_stream.log.indexed import IndexedFile
from roadperc_stream.log.limits import ATTACHED, LimitError, require_record
from roadperc_stream.log.mcap_file import Piece
from roadperc_stream.log.records import Channel, LogSummary, Message
from roadperc_stream.log.recovery import Salvage, audited, damage_in
from roadperc_stream.log.sorting import SortedMessages
from roadperc_stream.log.stored import AnyLog, LogFile


def summarise(source: AnyLog | Sequence[AnyLog], limits: LimitsConfig = DEFAULT_LIMITS) -> LogSummary:
    """Return channels, counts, attachments and metadata of a log, from its index if it has one.

    All CRCs are checked, and index and statistics are compared with the file. A log whose messages cannot be ordered in
    little memory is sorted on disk at the first reading. If files share topics at the same time, their messages are
    read to find repeated ones. ``limits`` are those of records and chunks.

    Raises:
        LogError: a file cannot be read, is not MCAP, is cut or damaged, or exceeds the limits.
        TargetError: there is no space to sort several files.
    """
    sources = [source] if isinstance(source, Path | LogFile) else source
    files, held_bytes = list[LogSummary](), 0
    for one in sources:
        files.append(_summary_of(LogFile.of(one), limits))
        held_bytes += sum(len(attachment.data) for attachment in files[-1].attachments)
        try:
            require_record(held_bytes, limits, ATTACHED)
        except LimitError as error:
            raise LogError(f"{one}: {error}") from error
    return united(files) if len(files) > 1 else files[0]


def read(
    summary: LogSummary,
    *,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Message]:
    """Yield messages in log-time order; those of equal time in file order.

    ``topics`` limits them; None yields all. Log times begin at ``start_ns`` and are earlier than ``end_ns``.

    Raises:
        LogError: the file cannot be read, is not MCAP, is cut or damaged.
        TargetError: there is no space to sort it.
    """
    return summary.source.messages(topics, start_ns, end_ns)


def pieces(
    summary: LogSummary, channels: Collection[Channel], start_ns: int | None, end_ns: int | None
) -> Iterator[Piece]:
    """Yield the messages of some channels, as whole chunks of the file if these contain nothing else.

    Times and errors are as in ``read``.
    """
    source, kept, topics = summary.source, frozenset(channels), {channel.topic for channel in channels}
    if isinstance(source, UnitedFiles) and source.in_turn:
        return chain.from_iterable(
            pieces(file, kept.intersection(file.channels), start_ns, end_ns) for file in source.in_turn
        )
    if isinstance(source, IndexedFile):
        return source.pieces(frozenset(channel.source_id for channel in kept), start_ns, end_ns)
    messages = read(summary, topics=topics, start_ns=start_ns, end_ns=end_ns)
    return (message for message in messages if message.channel in kept)


def _in_file_order(file: LogFile, limits: LimitsConfig) -> Iterator[Message]:
    """Yield the messages of a checked file in its order, one message of a chunk in memory at a time.

    Raises:
        LogError: the file cannot be read, or is damaged now.
    """
    found = Salvage(file, limits=limits)
    yield from found.messages()
    if not found.whole:
        raise damage_in(found)


def _summary_of(file: LogFile, limits: LimitsConfig) -> LogSummary:
    """Return the summary of one file.

    Raises:
        LogError: as ``summarise``.
    """
    found = audited(file, limits)
    if not found.whole:
        raise damage_in(found)
    in_order, described = SortedMessages(str(file), partial(_in_file_order, file, limits)), found.described
    channels = [found.channels[number] for number in sorted(found.channels)]
    return LogSummary(
        file.name,
        IndexedFile(found, in_order) if found.all_in_chunks else in_order,
        described.profile,
        tuple(channel if found.all_in_chunks else replace(channel, schema_id=0) for channel in channels),
        dict(found.counts),
        tuple(described.attachments),
        tuple(described.metadata),
        found.first_ns,
        found.last_ns,
    )
