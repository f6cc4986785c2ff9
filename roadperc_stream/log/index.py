"""What the index at a log's end says: channels, places, and what reading by it holds in memory."""

import heapq
import struct
from collections.abc import Iterable
from typing import IO, Final

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex
from mcap.records import Schema as McapSchema
from mcap.summary import Summary
from zstandard import ZstdError

from roadperc_stream.log.chunks import ChunkHead
from roadperc_stream.log.framing import Record
from roadperc_stream.log.records import Channel

MOST_HELD_BYTES: Final = 32 * 1024 * 1024
"""Messages held to put a log in order by its index; where it would take more it is sorted on disk."""


UNREADABLE: Final = (
    McapError,
    EOFError,
    ValueError,
    KeyError,
    OverflowError,
    RuntimeError,
    MemoryError,
    struct.error,
    ZstdError,
)
"""What the library and its decompressors throw at bytes that make no sense."""


def usable_index(reader: McapReader) -> Summary | None:
    """The log's index, where it names every chunk, channel and schema its messages use."""
    index = reader.get_summary()
    if index is None or index.statistics is None or not index.chunk_indexes:
        return None
    used = [index.channels.get(i) for i in index.statistics.channel_message_counts]
    known = all(channel is not None and channel.schema_id in {0, *index.schemas} for channel in used)
    whole = index.statistics.chunk_count == len(index.chunk_indexes)
    return index if known and whole and index.statistics.channel_count <= len(index.channels) else None


def most_at_once(spans: Iterable[tuple[int, int, int]]) -> int:
    """The largest sum of sizes of spans that overlap.

    Args:
        spans: (first, last, size) each, first and last included.
    """
    ends, size, most = list[tuple[int, int]](), 0, 0
    for first, last, more in sorted(spans):
        while ends and ends[0][0] < first:
            size -= heapq.heappop(ends)[1]
        heapq.heappush(ends, (last, more))
        size += more
        most = max(most, size)
    return most


def channel_of(channel: McapChannel, schema: McapSchema | None) -> Channel:
    """A channel with its schema, free of the library."""
    return Channel(
        channel.topic,
        channel.message_encoding,
        schema.name if schema else "",
        schema.encoding if schema else "",
        schema.data if schema else b"",
        tuple(sorted(channel.metadata.items())),
        channel.id,
    )


def span_ns_of(entry: ChunkIndex | None, head: ChunkHead | None) -> tuple[int, int] | None:
    """First and last log time of a chunk, by the index, else by itself."""
    if entry is not None:
        return entry.message_start_time, entry.message_end_time
    return (head.first_ns, head.last_ns) if head is not None and head.first_ns <= head.last_ns else None


def end_of(record: Record, entry: ChunkIndex | None, head: ChunkHead | None) -> int:
    """The byte behind a chunk, by the index, else by the one of its lengths that makes sense."""
    if entry is not None:
        return entry.chunk_start_offset + entry.chunk_length
    return record.start + head.record_bytes if record.fault and head is not None else record.end


def places_of(index: Summary, data_end: int | None) -> tuple[int, ...]:
    """Where reading can go on behind a break, by the index: chunks, what lies beside them, the data section's end."""
    places = {chunk.chunk_start_offset for chunk in index.chunk_indexes}
    places |= {attachment.offset for attachment in index.attachment_indexes}
    places |= {metadata.offset for metadata in index.metadata_indexes}
    return tuple(sorted(places if data_end is None else {*places, data_end}))


def index_of(stream: IO[bytes]) -> Summary | None:
    """The index, where there is one that can be used; None where the file's end is missing or makes no sense."""
    stream.seek(0)
    try:
        return usable_index(make_reader(stream))
    except (OSError, *UNREADABLE):  # a seek before the start is an OSError; one of the disk comes again in reading
        return None
