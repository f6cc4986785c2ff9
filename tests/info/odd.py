"""Writes logs with unusual properties, as other programs write them."""

import json

from mcap.writer import CompressionType, IndexType, Writer

STAMPED = {"type": "object", "properties": {"timestamp": {"type": "object"}}}
SECOND_NS = 1_000_000_000


def write(path, times, topic="/a", stamps=None, **options):
    """Write a log of JSON messages with these log times and stamps, in ns."""
    stamps = times if stamps is None else stamps
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=400, **({"compression": CompressionType.NONE} | options))
        writer.start()
        schema = writer.register_schema("Text", "jsonschema", json.dumps(STAMPED).encode())
        channel = writer.register_channel(topic, "json", schema)
        for time_ns, stamp_ns in zip(times, stamps, strict=True):
            writer.add_message(channel, time_ns, message(stamp_ns), time_ns)
        writer.finish()
    return path


def message(stamp_ns):
    sec, nsec = divmod(stamp_ns, SECOND_NS)
    return json.dumps({"timestamp": {"sec": sec, "nsec": nsec}, "text": "x" * 20}).encode()


WRITERS = {
    "no chunks": {"use_chunking": False},
    "no index": {"index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False},
    "no summary offsets": {"use_summary_offsets": False},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "no CRCs": {"enable_crcs": False},
}
