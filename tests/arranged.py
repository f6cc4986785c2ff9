"""Writes the messages of a log in other arrangements: without index, in one chunk, shuffled, in several files."""

import random
from itertools import pairwise

from mcap.writer import CompressionType, IndexType, Writer

from roadperc_stream import log
from roadperc_stream.log import LogWriter

ARRANGEMENTS = {
    "small chunks": {"chunk_size": 50_000, "compression": CompressionType.LZ4},
    "no index": {"index_types": IndexType.NONE},
    "no chunks": {"use_chunking": False},
    "no chunks, no summary": {"use_chunking": False, "use_statistics": False, "repeat_channels": False},
    "one chunk": {"chunk_size": 2**40},
    "one lz4 chunk": {"chunk_size": 2**40, "compression": CompressionType.LZ4},
}
"""Options of a writer for ordered messages."""


def arranged(source, target, messages=None, *, metadata=(), **options):
    """A log rewritten by the mcap library, with all or some of its messages."""
    summary = log.summarise(source)
    with target.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile=summary.profile)
        ids = {channel.source_id: _register(writer, channel) for channel in summary.channels}
        for m in log.read(summary) if messages is None else messages:
            writer.add_message(ids[m.channel.source_id], m.log_time_ns, m.data, m.publish_time_ns, m.sequence)
        for a in summary.attachments:
            writer.add_attachment(a.create_time_ns, a.log_time_ns, a.name, a.media_type, a.data)
        for record in (*summary.metadata, *metadata):
            writer.add_metadata(record.name, dict(record.values))
        writer.finish()
    return target


def _register(writer, channel):
    schema = 0
    if channel.schema_name:
        schema = writer.register_schema(channel.schema_name, channel.schema_encoding, channel.schema_data)
    return writer.register_channel(channel.topic, channel.message_encoding, schema, dict(channel.metadata))


def shuffled(source, target, seed=1, **options):
    """The messages in any order."""
    messages = list(log.read(log.summarise(source)))
    random.Random(seed).shuffle(messages)
    return arranged(source, target, messages, **options)


def by_topic(source, target):
    """All messages of a topic, then those of the next, so that each chunk spans the whole log."""
    messages = sorted(log.read(log.summarise(source)), key=lambda m: m.channel.topic)
    return arranged(source, target, messages, chunk_size=200_000)


def parts(source, folder, cuts, **options):
    """The messages in files, cut before these indices."""
    messages = list(log.read(log.summarise(source)))
    pairs = pairwise([0, *cuts, len(messages)])
    return [arranged(source, folder / f"part_{k}.mcap", messages[a:b], **options) for k, (a, b) in enumerate(pairs)]


def by_library(path, items, schemas=(("S", "y", b"s"),), **options):
    """A log by the mcap library, from (topic, log time) pairs; the last schema is that of ``/a``."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start()
        schema = [writer.register_schema(*values) for values in schemas][-1]
        ids = {"/a": writer.register_channel("/a", "x", schema), "/b": writer.register_channel("/b", "x", 0)}
        for number, (topic, time) in enumerate(items):
            writer.add_message(ids[topic], time, str(number).encode().ljust(200, b"."), abs(time - 1), number)
        writer.finish()
    return path


def by_us(path, messages, *, attachments=(), metadata=(), profile=""):
    """A log by this project's writer."""
    with LogWriter(path, profile=profile) as writer:
        for message in messages:
            writer.write(message)
        for attachment in attachments:
            writer.attach(attachment)
        for record in metadata:
            writer.describe(record)
    return path


def plain(messages):
    """Topic, times, sequence and data of messages."""
    return [(m.channel.topic, m.log_time_ns, m.publish_time_ns, m.sequence, m.data) for m in messages]
