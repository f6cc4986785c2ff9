"""What the index at a log's end says: which channels there are, and what reading by it holds in memory."""

import heapq
from collections.abc import Iterable
from typing import Final

from mcap.reader import McapReader
from mcap.records import Channel as McapChannel
from mcap.records import Schema as McapSchema
from mcap.summary import Summary

from roadperc_stream.log.records import Channel

MOST_HELD_BYTES: Final = 32 * 1024 * 1024
"""Messages held to put a log in order by its index; where it would take more it is sorted on disk."""


def usable_index(reader: McapReader) -> Summary | None:
    """The log's index, where it names every chunk, channel and schema its messages use."""
    index = reader.get_summary()
    if index is None or index.statistics is None or not index.chunk_indexes:
        return None
    used = [index.channels.get(i) for i in index.statistics.channel_message_counts]
    known = all(channel is not None and channel.schema_id in {0, *index.schemas} for channel in used)
    whole = index.statistics.chunk_count == len(index.chunk_indexes)
    return index if known and whole and index.statistics.channel_count <= len(index.channels) else None


def held_bytes(index: Summary) -> int:
    """The most that the library holds when it reads in the order of log time: chunks that overlap in time."""
    chunks = index.chunk_indexes
    return most_at_once((c.message_start_time, c.message_end_time, c.uncompressed_size) for c in chunks)


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
