"""Logs in: messages in log-time order, and what a log holds besides them.

A log that its index does not give in order is read in the order of the file, one message in memory at a time: the
library holds the whole of each chunk, and a log may be a single one.
"""

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from io import BufferedReader
from itertools import chain
from pathlib import Path
from typing import IO, Any, Final

import lz4.frame
from deflate import crc32
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from zstandard import ZstdDecompressor

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.audit import opened, require_undamaged
from roadperc_stream.log.chunks import INSIDE, wrong_crc
from roadperc_stream.log.index import MOST_HELD_BYTES, Described, usable_index
from roadperc_stream.log.indexed import IndexedFile
from roadperc_stream.log.layout import CHUNK, LENGTH, MAGIC, RECORD, chunk_head, message_head, parse
from roadperc_stream.log.limits import LimitError, require_attachments
from roadperc_stream.log.mcap_file import Piece
from roadperc_stream.log.parts import Part, UnitedParts, united
from roadperc_stream.log.records import Channel, LogSummary, Message
from roadperc_stream.log.sorting import SortedMessages


def _zstd(stream: IO[bytes]) -> IO[bytes]:
    return BufferedReader(ZstdDecompressor().stream_reader(stream, read_across_frames=True))


_DECOMPRESSORS: Final[Mapping[str, Callable[[Any], Any]]] = {
    "": lambda stream: stream,
    "zstd": _zstd,
    "lz4": lambda stream: lz4.frame.LZ4FrameFile(stream, mode="rb"),
}


class _Section:
    """A stream's next bytes: reads no further than they go, and sums them up."""

    def __init__(self, stream: "IO[bytes] | _Section", size_bytes: int) -> None:
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
        opcode, length = RECORD.unpack(stream.read(RECORD.size))
        left -= RECORD.size + length
        if opcode == Opcode.FOOTER:
            return
        if left < 0:
            raise McapError(f"a record of {length} bytes where {left + length} are left")
        following = stream.tell() + length
        yield opcode, _Section(stream, length)
        stream.seek(following)


@dataclass
class FileOrder:
    """Reads the messages of a log once, as they stand in the file. Every chunk's CRC is checked.

    ``described`` is complete when that is done.
    """

    described: Described = field(default_factory=Described)

    def messages(self, stream: IO[bytes]) -> Iterator[Message]:
        """Every message.

        Args:
            stream: over the whole file.

        Raises:
            McapError: the file is damaged; of bytes that make no sense others come as well, such as a ValueError.
        """
        for opcode, body in _records(stream):
            if opcode == Opcode.CHUNK:
                yield from self._messages_in(body)
            elif opcode in INSIDE:
                yield from self._messages_of(opcode, body.exactly(body.left))

    def _messages_in(self, chunk: _Section) -> Iterator[Message]:
        """The messages of a chunk."""
        fields = chunk.exactly(CHUNK.size)
        name_bytes = CHUNK.unpack(fields)[-1]
        head = chunk_head(fields + chunk.exactly(name_bytes + LENGTH.size))
        stored = _Section(chunk, head.stored_bytes)
        contents = _Section(_DECOMPRESSORS[head.compression](stored), head.size_bytes)
        while contents.left:
            opcode, length = RECORD.unpack(contents.exactly(RECORD.size))
            yield from self._messages_of(opcode, contents.exactly(length))
        if head.crc and contents.crc != head.crc:
            raise McapError(wrong_crc(contents.crc, head.crc))

    def _messages_of(self, opcode: int, body: bytes) -> Iterator[Message]:
        """The message of a record; of one that describes messages none, but it is taken note of."""
        if opcode != Opcode.MESSAGE:
            self.described.add(parse(opcode, body, spare_allowed=True), in_data=True)
            return
        head = message_head(body)
        if head.channel_id not in self.described.channels:
            raise McapError(f"no channel record found with id {head.channel_id}")
        yield head.of(self.described.channels[head.channel_id], body)


def summarise(
    source: Path | Sequence[Path],
    limits: LimitsConfig = DEFAULT_LIMITS,
    *,
    check_chunks: bool = False,
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

    Raises:
        LogError: a file cannot be read, is no MCAP, is cut or damaged, or is beyond the limits.
        TargetError: there is no space to put several files in order.
    """
    paths = [source] if isinstance(source, Path) else source
    parts, held_bytes = list[Part](), 0
    for path in paths:
        parts.append(_inspected(path, limits, check_chunks=check_chunks))
        held_bytes += sum(len(attachment.data) for attachment in parts[-1].summary.attachments)
        try:
            require_attachments(held_bytes, limits)
        except LimitError as error:
            raise LogError(f"{path}: {error}") from error
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


def in_file_order(path: Path, limits: LimitsConfig) -> Iterator[Message]:
    """Messages as they stand in the file, one in memory at a time; every chunk is checked.

    Raises:
        LogError: as ``read``.
    """
    with opened(path, limits) as stream:
        yield from FileOrder().messages(stream)


def _inspected(path: Path, limits: LimitsConfig, *, check_chunks: bool) -> Part:
    """What one file holds.

    Raises:
        LogError: as ``summarise``.
    """
    found = require_undamaged(path, limits, check_chunks=check_chunks)
    with opened(path, limits) as stream:
        reader = make_reader(stream)
        index = usable_index(reader) if found.all_in_chunks else None
        described = found.described
        in_order = SortedMessages(str(path), partial(in_file_order, path, limits))
        beside = tuple(described.attachments), tuple(described.metadata)
        summary = LogSummary(path, in_order, described.profile, (), {}, *beside)
        if index is None:
            return Part(_scanned(summary, stream), None, partial(in_file_order, limits=limits))
    file = IndexedFile.of(path, index, limits, check_chunks=not found.sealed)
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


def _scanned(summary: LogSummary, stream: IO[bytes]) -> LogSummary:
    """The summary of a log without an index, by reading it."""
    order, counts = FileOrder(), Counter[int]()
    first_ns: int | None = None
    last_ns: int | None = None
    for message in order.messages(stream):
        counts[message.channel.source_id] += 1
        first_ns = message.log_time_ns if first_ns is None else min(first_ns, message.log_time_ns)
        last_ns = message.log_time_ns if last_ns is None else max(last_ns, message.log_time_ns)
    channels = order.described.channels
    in_order = tuple(channels[i] for i in sorted(channels))
    return replace(summary, channels=in_order, counts=dict(counts), first_ns=first_ns, last_ns=last_ns)
