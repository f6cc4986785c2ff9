"""Logs in: messages in log-time order, and what a log holds besides them."""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO

from mcap.reader import McapReader, make_reader

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.audit import require_undamaged
from roadperc_stream.log.file_order import FileOrder, attachments_and_metadata
from roadperc_stream.log.index import MOST_HELD_BYTES, usable_index
from roadperc_stream.log.indexed import IndexedFile
from roadperc_stream.log.limits import LimitError, require_attachments
from roadperc_stream.log.opening import opened
from roadperc_stream.log.parts import Part, united
from roadperc_stream.log.records import Attachment, LogSummary, Message, Metadata
from roadperc_stream.log.sorting import SortedMessages
from roadperc_stream.log.stored import StoredLog


def summarise(
    source: Path | Sequence[Path],
    limits: LimitsConfig = DEFAULT_LIMITS,
    *,
    check_chunks: bool = False,
    is_audited: bool = False,
) -> LogSummary:
    """Channels, counts, attachments and metadata of a log, from its index where it has one.

    All CRCs are checked, and that index and statistics say what stands in the file. A log that its index does not give
    in order of log time with little memory is put in order on disk when it is first read. Where CRCs of chunks are all
    there is, they are checked when the chunks are read. Where files share topics at the same time, their messages are
    read to find those that several of them hold.

    Args:
        source: the log, or the files that are one log.
        limits: of their records and chunks.
        check_chunks: check them now.
        is_audited: whether an earlier summary of the same file, ``is_indexed``, has checked it: then only what is read
            of it is looked at, and chunks are checked when they are read.

    Raises:
        LogError: a file cannot be read, is no MCAP, is cut or damaged, or is beyond the limits.
        TargetError: there is no space to put several files in order.
    """
    paths = [source] if isinstance(source, Path) else source
    parts = list(_all_inspected(paths, limits, check_chunks=check_chunks, is_audited=is_audited))
    if len(parts) > 1:
        return united(parts)
    summary = parts[0].summary
    if not isinstance(summary.source, IndexedFile) or (parts[0].held_bytes or 0) <= MOST_HELD_BYTES:
        return summary
    in_order = SortedMessages(str(summary.path), partial(parts[0].in_file_order, summary.path))
    return replace(summary, source=IndexedOrSorted(summary.source, in_order))


@dataclass(frozen=True)
class IndexedOrSorted:
    """A log that is read by its index where that takes little memory, and is put in order on disk for the rest."""

    indexed: IndexedFile
    in_order: SortedMessages

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """As ``read``."""
        return self.chosen(topics, start_ns, end_ns).messages(topics, start_ns, end_ns)

    def chosen(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> IndexedFile | SortedMessages:
        """What some messages are read from."""
        is_little = self.indexed.held_bytes(topics, start_ns, end_ns) <= MOST_HELD_BYTES
        return self.indexed if is_little else self.in_order


def read(
    summary: LogSummary,
    *,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
) -> Iterator[Message]:
    """Messages in the order of their log time; those of equal time in the order of the file.

    Args:
        summary: of the log.
        topics: only these; None for all.
        start_ns: first log time read.
        end_ns: first log time no longer read.

    Raises:
        LogError: the file cannot be read, is no MCAP, is cut or damaged.
        TargetError: there is no space to put it in order.
    """
    return summary.source.messages(topics, start_ns, end_ns)


def in_file_order(path: Path, limits: LimitsConfig) -> Iterator[Message]:
    """Messages as they stand in the file, one in memory at a time; every chunk is checked.

    Raises:
        LogError: as ``read``.
    """
    with opened(path, limits) as stream:
        yield from FileOrder().messages(stream)


def is_indexed(summary: LogSummary) -> bool:
    """Whether a log is one file, and no repaired copy of it, whose index gives all its messages."""
    return isinstance(summary.source, IndexedFile | IndexedOrSorted) and not isinstance(summary.path, StoredLog)


def _all_inspected(
    paths: Sequence[Path], limits: LimitsConfig, *, check_chunks: bool, is_audited: bool
) -> Iterator[Part]:
    """What each file holds, as long as all of them together have no more attachments than may be.

    Raises:
        LogError: as ``summarise``.
    """
    held_bytes = 0
    for path in paths:
        part = _inspected(path, limits, check_chunks=check_chunks, is_audited=is_audited)
        held_bytes += sum(len(attachment.data) for attachment in part.summary.attachments)
        try:
            require_attachments(held_bytes, limits)
        except LimitError as error:
            raise LogError(f"{path}: {error}") from error
        yield part


def _inspected(path: Path, limits: LimitsConfig, *, check_chunks: bool, is_audited: bool) -> Part:
    """What one file holds.

    Raises:
        LogError: as ``summarise``.
    """
    found = None if is_audited else require_undamaged(path, limits, check_chunks=check_chunks)
    with opened(path, limits) as stream:
        reader = make_reader(stream)
        profile = reader.get_header().profile
        index = usable_index(reader) if found is None or found.all_in_chunks else None
        attachments, metadata = _besides_messages(reader, stream)
        in_order = SortedMessages(str(path), partial(in_file_order, path, limits))
        summary = LogSummary(path, in_order, profile, (), {}, attachments, metadata)
        if index is None:
            return Part(_scanned(summary, stream), None, partial(in_file_order, limits=limits))
    file = IndexedFile.of(path, index, limits, check_chunks=found is None or not found.sealed)
    statistics = index.statistics
    assert statistics is not None
    indexed = replace(
        summary,
        source=file,
        channels=tuple(file.channels.values()),
        schema_ids=file.schema_ids,
        counts=dict(statistics.channel_message_counts),
        first_ns=statistics.message_start_time,
        last_ns=statistics.message_end_time,
    )
    return Part(indexed, file.held_bytes(None, None, None), partial(in_file_order, limits=limits))


def _besides_messages(reader: McapReader, stream: IO[bytes]) -> tuple[tuple[Attachment, ...], tuple[Metadata, ...]]:
    """Attachments and metadata: all of them stand in the file, its index may name none."""
    index = reader.get_summary()
    statistics = index.statistics if index else None
    counted = statistics and statistics.attachment_count + statistics.metadata_count
    if index is not None and len(index.attachment_indexes) + len(index.metadata_indexes) == counted:
        attachments, metadata = list(reader.iter_attachments()), list(reader.iter_metadata())
    else:
        attachments, metadata = attachments_and_metadata(stream)
    return (
        tuple(Attachment(a.name, a.media_type, a.data, a.log_time, a.create_time) for a in attachments),
        tuple(Metadata(m.name, tuple(sorted(m.metadata.items()))) for m in metadata),
    )


def _scanned(summary: LogSummary, stream: IO[bytes]) -> LogSummary:
    """The summary of a log without an index, by reading it."""
    order, counts = FileOrder(), Counter[int]()
    first_ns: int | None = None
    last_ns: int | None = None
    for message in order.messages(stream):
        counts[message.channel.source_id] += 1
        first_ns = message.log_time_ns if first_ns is None else min(first_ns, message.log_time_ns)
        last_ns = message.log_time_ns if last_ns is None else max(last_ns, message.log_time_ns)
    channels = tuple(order.channels[i] for i in sorted(order.channels))
    return replace(summary, channels=channels, counts=dict(counts), first_ns=first_ns, last_ns=last_ns)
