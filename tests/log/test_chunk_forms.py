"""Chunks of unusual form: every reader sees all their messages, and a copy has normal chunks."""

import os
import struct
import zlib
from itertools import pairwise

import lz4.frame
import pytest
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.log import Channel, LogWriter, MessageCopy, Salvage
from roadperc_stream.log.mcap_file import ChunkRecords, McapFile

A = Channel("/a", "x", source_id=1)
MIDDLE = [(20, b"c" * 50), (30, b"d" * 50)]
CHUNKS = [[(0, b"a" * 50), (10, b"b" * 50)], MIDDLE, [(40, b"e" * 50), (50, b"f" * 50)]]
ALL = [item for chunk in CHUNKS for item in chunk]
COMPRESS = {"zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress}
SKIPPED = struct.pack("<II5s", 0x184D2A50, 5, b"hello")
"""A frame that decompressors skip."""


def framed(item):
    builder = RecordBuilder()
    item.write(builder)
    return builder.end()


def described(topic):
    return framed(records.Channel(1, topic, "x", {}, 0))


def message_of(time, data):
    return framed(records.Message(channel_id=1, log_time=time, publish_time=time, sequence=0, data=data))


def chunk_of(items=MIDDLE, *, before=b"", span=None, stored=None, compression="", entries=None):
    """A chunk of messages; arguments replace its correct fields."""
    data, places = before, []
    for time, content in items:
        places.append((time, len(data)))
        data += message_of(time, content)
    first, last = span or (items[0][0], items[-1][0])
    stored = data if stored is None else stored(data)
    name = struct.pack("<I", len(compression)) + compression.encode()
    body = struct.pack("<QQQI", first, last, len(data), zlib.crc32(data)) + name
    body += struct.pack("<Q", len(stored)) + stored
    indexes = b""
    for group in [places] if entries is None else entries(places):
        entry_bytes = b"".join(struct.pack("<QQ", *entry) for entry in group)
        indexes += struct.pack("<BQHI", 7, 6 + len(entry_bytes), 1, len(entry_bytes)) + entry_bytes
    return ChunkRecords(struct.pack("<BQ", 6, len(body)) + body, indexes)


def written(path, *chunks, outside=()):
    """A log of chunks, and of messages outside chunks."""
    with path.open("wb") as stream:
        file = McapFile(stream, "", "")
        file.add_channel(records.Channel(1, "/a", "x", {}, 0))
        for chunk in chunks:
            file.add_chunk(chunk)
        for time, data in outside:
            file._add(records.Message(channel_id=1, log_time=time, publish_time=time, sequence=0, data=data))
            file.counts[1] += 1
            file._last_ns = max(file._last_ns, time)
        file.finish()
    return path


def around(path, middle):
    return written(path, chunk_of(CHUNKS[0]), middle, chunk_of(CHUNKS[2]))


def plain(messages):
    return [(m.log_time_ns, m.data) for m in messages]


def copied(source, target):
    """Copy a log by its pieces; return for each whether it is a whole chunk."""
    summary, whole = log.summarise(source), []

    def noted():
        for piece in log.pieces(summary, summary.channels, None, None):
            whole.append(isinstance(piece, ChunkRecords))
            yield piece

    with LogWriter(target) as writer:
        MessageCopy(writer, summary.channels, noted()).rest()
    return whole


def in_frames(compression, number, before=b""):
    """Compress in several frames whose ends are not ends of records."""

    def stored(data):
        ends = [len(data) * k // number for k in range(number + 1)]
        return before + b"".join(COMPRESS[compression](data[i:k]) for i, k in pairwise(ends))

    return stored


def split_at_a_record(compression):
    """A chunk in two compressed frames, of which the second begins with a record."""
    end = len(message_of(*MIDDLE[0]))
    return chunk_of(
        compression=compression, stored=lambda data: b"".join(map(COMPRESS[compression], (data[:end], data[end:])))
    )


UNUSUAL = {
    "a wider span": chunk_of(span=(15, 35)),
    "described in two ways": chunk_of(before=described("/other") + described("/a")),
    "two frames of zstd": chunk_of(compression="zstd", stored=in_frames("zstd", 2)),
    "many frames of zstd": chunk_of(compression="zstd", stored=in_frames("zstd", 9)),
    "a frame of zstd behind one that is skipped": chunk_of(compression="zstd", stored=in_frames("zstd", 1, SKIPPED)),
    "two frames of lz4": chunk_of(compression="lz4", stored=in_frames("lz4", 2)),
    "frames of lz4, some of them empty": chunk_of(compression="lz4", stored=in_frames("lz4", 500)),
    "frames of zstd that begin with a record": split_at_a_record("zstd"),
    "frames of lz4 that begin with a record": split_at_a_record("lz4"),
}


@pytest.mark.parametrize("form", [form for form in UNUSUAL if "frame" not in form])
def test_a_copy_of_unusual_chunks_is_a_normal_log(tmp_path, form):
    source = around(tmp_path / "a.mcap", UNUSUAL[form])
    assert copied(source, tmp_path / "b.mcap") == [True, False, False, True]
    assert plain(log.read(log.summarise(tmp_path / "b.mcap"))) == ALL
    found = Salvage(tmp_path / "b.mcap").run()
    assert (found.whole, found.absent) == (True, ())
    with (tmp_path / "b.mcap").open("rb") as stream:
        assert [(m.log_time, m.data) for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()] == ALL


@pytest.mark.parametrize("form", [form for form in UNUSUAL if "frame" in form])
def test_all_frames_of_a_chunk_are_read(tmp_path, form):
    """A reader that stops after the first frame loses messages without a sign if a record ends there."""
    source = around(tmp_path / "a.mcap", UNUSUAL[form])
    assert plain(log.read(log.summarise(source))) == ALL
    assert Salvage(source).run().whole


@pytest.mark.parametrize("compression", COMPRESS)
def test_further_frames_stay_within_the_declared_size(tmp_path, compression):
    bomb = COMPRESS[compression](bytes(50_000_000))
    middle = chunk_of(compression=compression, stored=lambda data: COMPRESS[compression](data) + bomb)
    found = Salvage(around(tmp_path / "a.mcap", middle)).run()
    assert not found.whole
    assert "holds more than the" in found.damages[0].words


def test_an_empty_chunk_does_not_change_the_first_log_time(tmp_path):
    empty = chunk_of([], span=(0, 0), entries=lambda _: [[]])
    source = written(tmp_path / "a.mcap", empty, chunk_of(MIDDLE))
    data = bytearray(source.read_bytes())
    with source.open("rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_start_time == 0
    at = data.index(struct.pack("<QQ", 0, 30), data.rindex(struct.pack("<BQ", 11, 56)))
    data[at : at + 8] = struct.pack("<Q", 20)  # as other writers count
    data[-12:-8] = bytes(4)  # the summary's CRC
    source.write_bytes(data)
    assert copied(source, tmp_path / "b.mcap") == [True]
    assert log.summarise(tmp_path / "b.mcap").first_ns == 20


def test_messages_outside_chunks_are_read_despite_a_chunk_index(tmp_path):
    outside = [(40, b"e" * 50), (50, b"f" * 50)]
    source = written(tmp_path / "a.mcap", chunk_of(CHUNKS[0]), chunk_of(MIDDLE), outside=outside)
    assert plain(log.read(log.summarise(source))) == ALL
    copied(source, tmp_path / "b.mcap")
    assert plain(log.read(log.summarise(tmp_path / "b.mcap"))) == ALL


@pytest.mark.parametrize("left", [0.45, 0.8])
def test_a_file_that_is_cut_during_copying_is_an_error(tmp_path, left):
    large = [chunk_of([(time, b"." * 100_000) for time, _ in items]) for items in CHUNKS]
    source = written(tmp_path / "a.mcap", *large)
    summary = log.summarise(source)
    found = log.pieces(summary, summary.channels, None, None)
    next(found)
    os.truncate(source, int(left * source.stat().st_size))
    with pytest.raises(LogError, match=r"a\.mcap: "):
        list(found)
