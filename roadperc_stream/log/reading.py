"""Logs in: messages in log-time order, and what a log holds beside them."""

import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, TypeVar

from mcap.exceptions import McapError
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Channel as McapChannel
from mcap.records import Schema as McapSchema
from mcap.summary import Summary
from zstandard import ZstdError

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.integrity import check_sections, damaged, require_whole, unopened
from roadperc_stream.log.limits import (
    GuardedFile,
    LimitError,
    attachments_in,
    check_chunk,
    chunk_starts,
    metadata_in,
    require_affordable,
)
from roadperc_stream.log.records import Attachment, Channel, LogSummary, Message, Metadata

T = TypeVar("T")


@contextmanager
def _reading(path: Path, limits: LimitsConfig) -> Iterator[IO[bytes]]:
    """Open a log; everything the file or the library can throw becomes one LogError that names the file."""
    try:
        with GuardedFile(path, limits) as stream:
            require_whole(path, stream)
            yield stream
    except OSError as error:
        raise unopened(path, error) from error
    except LimitError as error:
        raise LogError(f"{path}: {error}") from error
    except McapError as error:
        raise damaged(path, f"damaged MCAP: {str(error) or 'it ends before its contents do'}") from error
    except (EOFError, ValueError, KeyError, OverflowError, RuntimeError, MemoryError, struct.error, ZstdError) as error:
        raise damaged(path, f"damaged MCAP: {type(error).__name__}: {error}") from error


def summarise(path: Path, limits: LimitsConfig = DEFAULT_LIMITS) -> LogSummary:
    """Channels, counts, attachments and metadata of a log, from its index where it has one.

    The CRCs over the whole file are checked as it is read.

    Raises:
        LogError: the file cannot be read, is no MCAP, is cut or damaged, or is beyond the limits.
    """
    with _reading(path, limits) as stream:
        sealed = check_sections(path, stream)
        stream.seek(0)
        reader = make_reader(stream)
        profile = reader.get_header().profile
        index = usable_index(reader)
        attachments = tuple(
            Attachment(a.name, a.media_type, a.data, a.log_time, a.create_time)
            for a in _beside_messages(stream, lambda reader: reader.iter_attachments(), attachments_in)
        )
        metadata = tuple(
            Metadata(m.name, tuple(sorted(m.metadata.items())))
            for m in _beside_messages(stream, lambda reader: reader.iter_metadata(), metadata_in)
        )
    if index is None:
        return _scan(path, limits, LogSummary(path, profile, (), {}, attachments, metadata, sealed=sealed))
    channels = tuple(
        channel_of(index.channels[i], index.schemas.get(index.channels[i].schema_id)) for i in sorted(index.channels)
    )
    statistics = index.statistics
    assert statistics is not None
    return LogSummary(
        path,
        profile,
        channels,
        dict(statistics.channel_message_counts),
        attachments,
        metadata,
        statistics.message_start_time,
        statistics.message_end_time,
        sealed,
    )


def read(
    path: Path,
    *,
    topics: Collection[str] | None = None,
    start_ns: int | None = None,
    end_ns: int | None = None,
    validate_crcs: bool = False,
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> Iterator[Message]:
    """Messages in the order of their log time; those of equal time in the order of the file.

    A log without an index is held in memory to be put in order.

    Args:
        path: the log.
        topics: only these; None for all.
        start_ns: first log time read.
        end_ns: first log time no longer read.
        validate_crcs: check every chunk; a pass over the whole file needs it once.
        limits: of its records and chunks.

    Raises:
        LogError: the file cannot be read, is no MCAP, is cut or damaged, or is beyond the limits.
    """
    known: dict[int, Channel] = {}
    with _reading(path, limits) as stream:
        reader: McapReader = make_reader(stream, validate_crcs=validate_crcs)
        index = usable_index(reader)
        if index is not None:
            require_affordable(stream, index.chunk_indexes, limits)
        else:
            for start in chunk_starts(stream):
                stream.seek(start)
                check_chunk(stream, limits)
            stream.seek(0)
            reader = NonSeekingReader(stream, validate_crcs=validate_crcs)
        wanted = None if topics is None else list(topics)
        for schema, channel, message in reader.iter_messages(wanted, starting_at=start_ns, ending_before=end_ns):
            if channel.id not in known:
                known[channel.id] = channel_of(channel, schema)
            yield Message(known[channel.id], message.log_time, message.publish_time, message.sequence, message.data)


def usable_index(reader: McapReader) -> Summary | None:
    """The log's index, where it names every chunk, channel and schema its messages use."""
    index = reader.get_summary()
    if index is None or index.statistics is None or not index.chunk_indexes:
        return None
    used = [index.channels.get(i) for i in index.statistics.channel_message_counts]
    known = all(channel is not None and channel.schema_id in {0, *index.schemas} for channel in used)
    whole = index.statistics.chunk_count == len(index.chunk_indexes)
    return index if known and whole and index.statistics.channel_count <= len(index.channels) else None


def _beside_messages(
    stream: IO[bytes], records: Callable[[McapReader], Iterator[T]], unindexed: Callable[[IO[bytes]], list[T]]
) -> list[T]:
    """Attachments or metadata: all of them stand in the file, its index may name none."""
    stream.seek(0)
    index = make_reader(stream).get_summary()
    statistics = index.statistics if index else None
    stream.seek(0)
    if index is not None and statistics is not None:
        indexed = len(index.attachment_indexes) + len(index.metadata_indexes)
        if indexed == statistics.attachment_count + statistics.metadata_count:
            return list(records(make_reader(stream, validate_crcs=True)))
    return unindexed(stream)


def _scan(path: Path, limits: LimitsConfig, summary: LogSummary) -> LogSummary:
    """The summary of a log without an index, by reading it."""
    channels: dict[int, Channel] = {}
    counts: Counter[int] = Counter()
    first = last = None
    for message in read(path, limits=limits):
        source = message.channel.source_id
        channels.setdefault(source, message.channel)
        counts[source] += 1
        first = message.log_time_ns if first is None else first
        last = message.log_time_ns
    ordered = tuple(channels[source] for source in sorted(channels))
    return replace(summary, channels=ordered, counts=counts, first_ns=first, last_ns=last)


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
