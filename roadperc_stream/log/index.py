"""Reads everything in a log except messages: index, header, schemas, channels, attachments and metadata."""

import heapq
import os
import struct
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Final, TypeVar

from deflate import crc32
from mcap import records
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex
from mcap.records import Schema as McapSchema
from mcap.summary import Summary

from roadperc_stream.config import DEFAULT_LIMITS
from roadperc_stream.errors import LogError
from roadperc_stream.log.layout import CRC_BYTES, MAGIC, UNREADABLE
from roadperc_stream.log.limits import GuardedFile
from roadperc_stream.log.records import Attachment, Channel, Metadata

MOST_HELD_BYTES: Final = 32 * 1024 * 1024
"""Most memory for messages while a log is put in order by its index; beyond, it is sorted on disk."""
T = TypeVar("T")
_FOOTER: Final = struct.Struct("<BQQQI")
_DATA_END: Final = struct.Struct("<BQI")
_BLOCK_BYTES: Final = 1024 * 1024


def most_at_once(spans: Iterable[tuple[int, int, int]]) -> int:
    """Return the largest total size of spans that overlap: (first, last, size) each, first and last included."""
    ends, size, most = list[tuple[int, int]](), 0, 0
    for first, last, more in sorted(spans):
        while ends and ends[0][0] < first:
            size -= heapq.heappop(ends)[1]
        heapq.heappush(ends, (last, more))
        size += more
        most = max(most, size)
    return most


def held_bytes(chunks: Iterable[ChunkIndex]) -> int:
    """Return the most memory that reading chunks in log-time order takes."""
    return most_at_once((chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size) for chunk in chunks)


def may_hold(chunk: ChunkIndex, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> bool:
    """Return whether a chunk may have messages of these channels and times; without message indexes it may."""
    in_time = chunk.message_end_time >= (start_ns or 0) and (end_ns is None or chunk.message_start_time < end_ns)
    channels = chunk.message_index_offsets.keys()
    return in_time and (not channels or not channels.isdisjoint(wanted))


def share_channels(chunk: ChunkIndex, known: dict[frozenset[int], dict[int, int]]) -> None:
    """Let chunks of the same channels share a dict to save memory; only its keys are used."""
    offsets = chunk.message_index_offsets
    chunk.message_index_offsets = known.setdefault(frozenset(offsets), offsets)


def is_within(log_time_ns: int, start_ns: int | None, end_ns: int | None) -> bool:
    """Return whether a log time is in a range; None is no limit."""
    return (start_ns is None or log_time_ns >= start_ns) and (end_ns is None or log_time_ns < end_ns)


def channel_of(channel: McapChannel, schema: McapSchema | None) -> Channel:
    """Return a channel with its schema, independent of the mcap library."""
    described = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
    labels = tuple(sorted(channel.metadata.items()))
    return Channel(channel.topic, channel.message_encoding, *described, labels, channel.id)


def places_of(index: Summary, data_end: int | None) -> tuple[int, ...]:
    """Return the positions of records in the index: chunks, attachments, metadata, the data section's end."""
    places = {chunk.chunk_start_offset for chunk in index.chunk_indexes}
    places |= {attachment.offset for attachment in index.attachment_indexes}
    places |= {metadata.offset for metadata in index.metadata_indexes}
    return tuple(sorted(places if data_end is None else {*places, data_end}))


def index_of(stream: IO[bytes]) -> Summary | None:
    """Return the index if it names every chunk, channel and schema that messages use; its CRC may be wrong."""
    stream.seek(0)
    try:
        index = make_reader(stream).get_summary()
    except (OSError, *UNREADABLE):  # OSError: a seek before the start; an error of the disk comes again in reading
        return None
    if index is None or index.statistics is None or not index.chunk_indexes:
        return None
    used = [index.channels.get(i) for i in index.statistics.channel_message_counts]
    known = all(channel is not None and channel.schema_id in {0, *index.schemas} for channel in used)
    whole = index.statistics.chunk_count == len(index.chunk_indexes)
    return index if known and whole and index.statistics.channel_count <= len(index.channels) else None


def outline(path: Path) -> tuple[tuple[str, ...], tuple[Channel, ...]]:
    """Return the names of the metadata records and the channels, by the index; both are empty without an index.

    Raises:
        LogError: the file cannot be read, is not MCAP, or its end is cut or damaged.
    """
    try:
        with GuardedFile(path, DEFAULT_LIMITS) as stream:
            index = make_reader(stream).get_summary()
    except (OSError, *UNREADABLE) as error:
        raise LogError(f"{path}: {error}") from error
    if index is None:
        return (), ()
    channels = (channel_of(channel, index.schemas.get(channel.schema_id)) for channel in index.channels.values())
    return tuple(metadata.name for metadata in index.metadata_indexes), tuple(channels)


def data_end_of(stream: IO[bytes]) -> int | None:
    """Return the byte where the data section's last record starts, from the footer; None if there is no such record."""
    footer_start, summary_start, _ = _footer(stream)
    data_end = (summary_start or footer_start) - _DATA_END.size
    is_data_end = footer_start and _unpack(stream, _DATA_END, data_end)[0] == Opcode.DATA_END
    return data_end if is_data_end else None


def summary_fits(stream: IO[bytes]) -> bool:
    """Return whether the CRC of the summary is correct; true without a CRC."""
    footer_start, summary_start, expected = _footer(stream)
    if not expected or not summary_start:
        return True
    if summary_start >= footer_start:
        return False
    crc, left = 0, footer_start + _FOOTER.size - CRC_BYTES - stream.seek(summary_start)
    while left > 0 and (block := stream.read(min(left, _BLOCK_BYTES))):
        crc, left = crc32(block, crc), left - len(block)
    return crc == expected


def _footer(stream: IO[bytes]) -> tuple[int, int, int]:
    """Return where footer and summary start, and the summary's CRC; zeros if the file does not end with a footer."""
    start = stream.seek(0, os.SEEK_END) - len(MAGIC) - _FOOTER.size
    opcode, _, summary_start, _, crc = _unpack(stream, _FOOTER, start)
    return (start, summary_start, crc) if opcode == Opcode.FOOTER else (0, 0, 0)


def _unpack(stream: IO[bytes], record: struct.Struct, start: int) -> tuple[int, ...]:
    """Return the fields of a record; zeros outside the file."""
    stream.seek(max(start, 0))
    content = stream.read(record.size) if start >= 0 else b""
    return record.unpack(content.ljust(record.size, b"\0"))


@dataclass
class Described:
    """Collects descriptions record by record. Those in the data section replace those in the index."""

    profile: str = ""
    library: str = ""
    """The program that wrote the log."""
    channels: dict[int, Channel] = field(default_factory=dict)
    """By ``Channel.source_id``."""
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    _schemas: dict[int, records.Schema] = field(default_factory=dict)
    _unsettled: set[tuple[str, int]] = field(default_factory=set)
    """Schemas and channels that only the index has described yet."""

    def add_index(self, index: Summary) -> None:
        """Add the descriptions in the index, for messages whose description in the data section is lost."""
        self._schemas |= index.schemas
        for channel in index.channels.values():
            self.channels[channel.id] = channel_of(channel, self._schemas.get(channel.schema_id))
        self._unsettled = {("schema", i) for i in self._schemas} | {("channel", i) for i in self.channels}

    def add(self, item: records.McapRecord, *, in_data: bool) -> None:
        """Add what a record describes; other kinds are ignored.

        Raises:
            ValueError: it describes a channel or a schema differently than an earlier record.
        """
        match item:
            case records.Header():
                self.profile, self.library = item.profile, item.library
            case records.Schema():
                self._keep(self._schemas, item.id, item, "schema", in_data=in_data)
            case records.Channel():
                if item.schema_id and item.schema_id not in self._schemas:
                    raise ValueError(f"channel {item.id} has schema {item.schema_id}, which the log does not describe")
                channel = channel_of(item, self._schemas.get(item.schema_id))
                self._keep(self.channels, item.id, channel, "channel", in_data=in_data)
            case records.Attachment():
                attachment = Attachment(item.name, item.media_type, item.data, item.log_time, item.create_time)
                self.attachments.append(attachment)
            case records.Metadata():
                self.metadata.append(Metadata(item.name, tuple(sorted(item.metadata.items()))))

    def _keep(self, known: dict[int, T], number: int, item: T, kind: str, *, in_data: bool) -> None:
        """Add a schema or a channel; the data section's replaces the index's."""
        if in_data and (kind, number) in self._unsettled:
            self._unsettled.discard((kind, number))
            known[number] = item
        if known.setdefault(number, item) != item:
            raise ValueError(f"{kind} {number} is described twice, differently")
