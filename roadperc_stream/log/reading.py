"""Logs in: messages in log-time order, and what a log holds beside them."""

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TypeVar

from mcap.reader import McapReader, NonSeekingReader, make_reader

from roadperc_stream.log.audit import damage_in, require_undamaged, salvaged
from roadperc_stream.log.index import UNREADABLE, channel_of, usable_index
from roadperc_stream.log.integrity import damaged, require_whole, unopened
from roadperc_stream.log.records import Attachment, Channel, LogSummary, Message, Metadata

T = TypeVar("T")


@contextmanager
def _reading(path: Path) -> Iterator[IO[bytes]]:
    """Open a log; everything the file or the library can throw becomes one LogError that names the file."""
    try:
        with path.open("rb") as stream:
            require_whole(path, stream)
            yield stream
    except OSError as error:
        raise unopened(path, error) from error
    except UNREADABLE as error:
        found = salvaged(path)
        words = f"damaged MCAP: {type(error).__name__}: {error}"
        raise (damaged(path, words) if found.whole else damage_in(found)) from error


def summarise(path: Path) -> LogSummary:
    """Channels, counts, attachments and metadata of a log, from its index where it has one.

    All CRCs are checked, and that index and statistics say what stands in the file.

    Raises:
        LogError: the file cannot be read, is no MCAP, is cut or damaged.
    """
    sealed = require_undamaged(path)
    with _reading(path) as stream:
        reader = make_reader(stream)
        profile = reader.get_header().profile
        index = usable_index(reader)
        attachments = tuple(
            Attachment(a.name, a.media_type, a.data, a.log_time, a.create_time)
            for a in _beside_messages(stream, lambda reader: reader.iter_attachments())
        )
        metadata = tuple(
            Metadata(m.name, tuple(sorted(m.metadata.items())))
            for m in _beside_messages(stream, lambda reader: reader.iter_metadata())
        )
    if index is None:
        return _scan(path, profile, attachments, metadata, sealed)
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
) -> Iterator[Message]:
    """Messages in the order of their log time; those of equal time in the order of the file.

    A log without an index is held in memory to be put in order.

    Args:
        path: the log.
        topics: only these; None for all.
        start_ns: first log time read.
        end_ns: first log time no longer read.
        validate_crcs: check every chunk; a pass over the whole file needs it once.

    Raises:
        LogError: the file cannot be read, is no MCAP, is cut or damaged.
    """
    known: dict[int, Channel] = {}
    with _reading(path) as stream:
        reader: McapReader = make_reader(stream, validate_crcs=validate_crcs)
        if usable_index(reader) is None:
            stream.seek(0)
            reader = NonSeekingReader(stream, validate_crcs=validate_crcs)
        wanted = None if topics is None else list(topics)
        for schema, channel, message in reader.iter_messages(wanted, starting_at=start_ns, ending_before=end_ns):
            if channel.id not in known:
                known[channel.id] = channel_of(channel, schema)
            yield Message(known[channel.id], message.log_time, message.publish_time, message.sequence, message.data)


def _beside_messages(stream: IO[bytes], records: Callable[[McapReader], Iterator[T]]) -> list[T]:
    """Attachments or metadata: all of them stand in the file, its index may name none."""
    stream.seek(0)
    index = make_reader(stream).get_summary()
    statistics = index.statistics if index else None
    stream.seek(0)
    if index is not None and statistics is not None:
        indexed = len(index.attachment_indexes) + len(index.metadata_indexes)
        if indexed == statistics.attachment_count + statistics.metadata_count:
            return list(records(make_reader(stream, validate_crcs=True)))
    return list(records(NonSeekingReader(stream)))


def _scan(
    path: Path, profile: str, attachments: tuple[Attachment, ...], metadata: tuple[Metadata, ...], sealed: bool
) -> LogSummary:
    """The summary of a log without an index, by reading it."""
    channels: dict[int, Channel] = {}
    counts: Counter[int] = Counter()
    first = last = None
    for message in read(path):
        source = message.channel.source_id
        channels.setdefault(source, message.channel)
        counts[source] += 1
        first = message.log_time_ns if first is None else first
        last = message.log_time_ns
    ordered = tuple(channels[source] for source in sorted(channels))
    return LogSummary(path, profile, ordered, counts, attachments, metadata, first, last, sealed)
