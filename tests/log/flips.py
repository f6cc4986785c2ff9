"""Logs of many shapes without CRCs, and the effect of one flipped bit on the messages that are read."""

from collections import Counter
from random import Random

from mcap.writer import CompressionType, IndexType, Writer

from roadperc_stream import log
from roadperc_stream.errors import LogError

STEP_NS = 10_000_000
FIRST_NS = 1_600_000_000_000_000_000
TOPICS = ("/image", "/depth", "/tf")
NO_CRC = {"enable_crcs": False, "enable_data_crcs": False}
SHAPES = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "no chunk index": {"compression": CompressionType.NONE, "index_types": IndexType.ALL & ~IndexType.CHUNK},
    "no message index": {"compression": CompressionType.NONE, "index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "no index": {"compression": CompressionType.NONE, "index_types": IndexType.NONE},
    "no statistics": {"compression": CompressionType.NONE, "use_statistics": False},
    "no index, no statistics": {
        "compression": CompressionType.NONE,
        "index_types": IndexType.NONE,
        "use_statistics": False,
    },
    "unchunked": {"use_chunking": False},
    "unchunked, no statistics": {"use_chunking": False, "use_statistics": False},
}


def write(path, *, messages=60, chunk_size=1500, seed=0, **options):
    """A log of three topics whose messages differ in size and content."""
    random = Random(seed)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, **(NO_CRC | options))
        writer.start()
        schema = writer.register_schema("Text", "jsonschema", b"{}")
        channels = [writer.register_channel(topic, "json", schema, {"a": "b"}) for topic in TOPICS]
        for k in range(messages):
            time_ns = FIRST_NS + k * STEP_NS
            writer.add_message(channels[k % 3], time_ns, random.randbytes(random.randint(40, 160)), time_ns, k)
        writer.add_attachment(FIRST_NS, FIRST_NS, "a.txt", "text/plain", b"attached")
        writer.add_metadata("notes", {"k": "v"})
        writer.finish()
    return path


def flipped(content, bit):
    """The content with one bit flipped."""
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def outcome(path, truth, *, counted=True):
    """Return the outcome of reading a log: ``refused``, ``lost`` (silently), or ``read``.

    Args:
        path: the log.
        truth: messages by topic.
        counted: whether the log counts the messages of each channel. Otherwise a message that a bit moves to another
            channel cannot be detected.
    """
    try:
        summary = log.summarise(path)
        messages = list(log.read(summary))
        parts = [part for limits in ranges() for part in [(limits, list(log.read(summary, **limits)))]]
        topics = [list(log.read(summary, topics=[topic])) for topic in truth]
    except LogError:
        return "refused"
    found = Counter(message.channel.topic for message in messages)
    if len(messages) == sum(truth.values()) and not counted:
        return "read"
    if any(found[topic] < number for topic, number in truth.items()):
        return "lost"
    inside = [sum(_is_inside(message, **limits) for message in messages) for limits, _ in parts]
    if inside != [len(part) for _, part in parts] or [len(part) for part in topics] != list(map(found.get, truth)):
        return "lost"
    return "read"


def ranges():
    """Ranges of the log that are read by its index."""
    for first, last in ((0, 15), (20, 40), (45, 60)):
        yield {"start_ns": FIRST_NS + first * STEP_NS, "end_ns": FIRST_NS + last * STEP_NS}


def _is_inside(message, start_ns, end_ns):
    return start_ns <= message.log_time_ns < end_ns
