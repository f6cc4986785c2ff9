"""Reads everything in a log except messages: index, header, schemas, channels, attachments and metadata."""

import heapq
import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Final, TypeVar

from mcap import records
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, McapRecord
from mcap.records import Schema as McapSchema

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.layout import MAGIC, PARSED, RECORD, UNREADABLE, parse, records_in
from roadperc_stream.log.limits import require_record
from roadperc_stream.log.records import Attachment, Channel, Metadata

MOST_HELD_BYTES: Final = 32 * 1024 * 1024
"""Most memory for messages while a log is put in order by its index; beyond, it is sorted on disk."""
T = TypeVar("T")


def held_bytes(chunks: Iterable[ChunkIndex]) -> int:
    """Return the most memory that reading chunks in log-time order takes: the largest total size that overlaps."""
    ends, size, most = list[tuple[int, int]](), 0, 0
    for chunk in sorted(chunks, key=lambda chunk: chunk.message_start_time):
        while ends and ends[0][0] < chunk.message_start_time:
            size -= heapq.heappop(ends)[1]
        heapq.heappush(ends, (chunk.message_end_time, chunk.uncompressed_size))
        size += chunk.uncompressed_size
        most = max(most, size)
    return most


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
    return Channel(channel.topic, channel.message_encoding, *described, labels, channel.id, channel.schema_id)


def summary_of(stream: IO[bytes], limits: LimitsConfig) -> tuple[int, list[McapRecord]]:
    """Return the first byte of a file's summary section, and its records; 0 and none without one.

    Raises:
        UNREADABLE: the end of the file is cut or damaged.
    """
    end = stream.seek(-FOOTER_SIZE - len(MAGIC), os.SEEK_END)
    footer = stream.read(FOOTER_SIZE)
    start: int = parse(Opcode.FOOTER, footer[RECORD.size :]).summary_start
    if footer[0] != Opcode.FOOTER or not 0 <= start <= end:
        raise McapError("no footer: its end is cut or damaged")
    if not start:
        return 0, []
    require_record(end - start, limits)
    stream.seek(start)
    return start, [
        parse(item.opcode, bytes(item.body)) for item in records_in(stream.read(end - start)) if item.opcode in PARSED
    ]


def outline(path: Path) -> tuple[tuple[str, ...], tuple[Channel, ...]]:
    """Return the names of the metadata records and the channels, by the index; both are empty without an index.

    Raises:
        LogError: the file cannot be read, is not MCAP, or its end is cut or damaged.
    """
    found, names = Described(), list[str]()
    try:
        with path.open("rb") as stream:
            for item in summary_of(stream, DEFAULT_LIMITS)[1]:
                found.add(item, in_data=False)
                names += [item.name] if isinstance(item, records.MetadataIndex) else []
    except (OSError, *UNREADABLE) as error:
        raise LogError(f"{path}: {error}") from error
    return tuple(names), tuple(found.channels.values())


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
    schemas: dict[int, McapSchema] = field(default_factory=dict)
    """By the file's id."""
    _of_data: set[tuple[str, int]] = field(default_factory=set)
    """Kind and id of what the data section described."""

    def add(self, item: records.McapRecord, *, in_data: bool) -> None:
        """Add what a record describes; other kinds are ignored.

        Raises:
            ValueError: it describes a channel or a schema differently than an earlier record.
        """
        match item:
            case records.Header():
                self.profile, self.library = item.profile, item.library
            case records.Schema():
                self._keep(self.schemas, item.id, item, "schema", in_data=in_data)
            case records.Channel():
                if item.schema_id and item.schema_id not in self.schemas:
                    raise ValueError(f"channel {item.id} has schema {item.schema_id}, which the log does not describe")
                channel = channel_of(item, self.schemas.get(item.schema_id))
                self._keep(self.channels, item.id, channel, "channel", in_data=in_data)
            case records.Attachment():
                attachment = Attachment(item.name, item.media_type, item.data, item.log_time, item.create_time)
                self.attachments.append(attachment)
            case records.Metadata():
                self.metadata.append(Metadata(item.name, tuple(sorted(item.metadata.items()))))

    def _keep(self, known: dict[int, T], number: int, item: T, kind: str, *, in_data: bool) -> None:
        """Add a schema or a channel; the data section's replaces the index's."""
        if in_data and (kind, number) not in self._of_data:
            self._of_data.add((kind, number))
            known[number] = item
        elif known.setdefault(number, item) != item:
            raise ValueError(f"{kind} {number} is described twice, differently")
