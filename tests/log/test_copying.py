"""Whole chunks of the input are copied unchanged; all other messages are rewritten."""

import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap import records
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.log import Channel, LogWriter, Message, MessageCopy
from roadperc_stream.log.mcap_file import ChunkRecords, McapFile, OpenChunk
from tests.arranged import by_library, plain

A, B = Channel("/a", "x", "S", "y", b"s", source_id=1), Channel("/b", "x", source_id=2)
RESULT = Channel("/result", "x", "S", "y", b"s", metadata=(("producer", "roadperc"),))


TWO = 400
"""Size of chunks that hold two messages."""


def copied(source, target, topics=("/a", "/b"), start_ns=None, end_ns=None, results=()):
    """Copy a log or its files by pieces, with a result at each of these times; return the pieces."""
    summary = log.summarise(source)
    channels = [channel for channel in summary.channels if channel.topic in topics]
    found = []

    def noted():
        for piece in log.pieces(summary, channels, start_ns, end_ns):
            found.append(piece)
            yield piece

    with LogWriter(target) as writer:
        copy = MessageCopy(writer, channels, noted())
        writer.register(RESULT)
        for time in results:
            copy.through(time)
            writer.write(Message(RESULT, time, time, 0, b"r"))
        copy.rest()
    return found


def index_of(path):
    with path.open("rb") as stream:
        return make_reader(stream).get_summary()


def inputs(path):
    return [m for m in plain(log.read(log.summarise(path))) if m[0] != "/result"]


def whole(pieces):
    return [isinstance(piece, ChunkRecords) for piece in pieces]


IN_ORDER = [(("/a", "/b")[k % 2], 10 * (k // 2)) for k in range(12)]


@pytest.mark.parametrize("compression", CompressionType)
def test_chunks_are_copied_byte_for_byte(tmp_path, compression):
    source = by_library(tmp_path / "a.mcap", IN_ORDER, chunk_size=TWO, compression=compression)
    pieces = copied(source, tmp_path / "b.mcap", results=[0, 10, 20])
    assert all(whole(pieces))
    assert len(pieces) == len(index_of(source).chunk_indexes) > 2
    data = (tmp_path / "b.mcap").read_bytes()
    assert all(piece.record + piece.indexes in data for piece in pieces)
    assert inputs(tmp_path / "b.mcap") == plain(log.read(log.summarise(source)))
    assert log.audited(tmp_path / "b.mcap").whole


def test_the_library_reads_copied_chunks(tmp_path):
    source = by_library(tmp_path / "a.mcap", IN_ORDER, chunk_size=TWO)
    copied(source, tmp_path / "b.mcap", results=[0, 10, 20])
    with (tmp_path / "b.mcap").open("rb") as stream:
        found = list(make_reader(stream, validate_crcs=True).iter_messages())
        assert [m.sequence for _, c, m in found if c.topic != "/result"] == list(range(12))
        assert all((schema.name if schema else "") == ("" if c.topic == "/b" else "S") for schema, c, _ in found)
        stream.seek(0)
        in_file = [r for r in StreamReader(stream, validate_crcs=True).records if type(r).__name__ == "Message"]
    assert len(in_file) == len(found) == 15


def test_channels_and_schemas_keep_their_ids(tmp_path):
    source = by_library(tmp_path / "a.mcap", IN_ORDER, chunk_size=TWO)
    copied(source, tmp_path / "b.mcap", topics=["/b"], results=[0])
    summary = log.summarise(tmp_path / "b.mcap")
    channels = {c.topic: (c.source_id, c.schema_id) for c in summary.channels}
    assert channels == {"/b": (2, 0), "/result": (3, 1)}


def test_a_chunk_without_crc_gets_one(tmp_path):
    source = by_library(
        tmp_path / "a.mcap", IN_ORDER, chunk_size=TWO, enable_crcs=False, compression=CompressionType.NONE
    )
    pieces = copied(source, tmp_path / "b.mcap")
    assert all(whole(pieces))
    for piece in pieces:
        start = len(piece.record) - int.from_bytes(piece.record[25:33], "little")
        assert piece.head.crc == zlib.crc32(piece.record[start:])
    assert inputs(tmp_path / "b.mcap") == plain(log.read(log.summarise(source)))
    assert log.audited(tmp_path / "b.mcap").absent == ()


UP = [("/a", 10 * k) for k in range(6)]


@pytest.mark.parametrize(
    ("items", "options", "expected"),
    [
        (UP, {"start_ns": 5}, [False, True, True]),
        (UP, {"end_ns": 25}, [True, False]),
        (IN_ORDER[:6], {"topics": ["/a"]}, [False] * 3),
        ([("/a", 0), ("/a", 3), ("/a", 2), ("/a", 9), ("/a", 10), ("/a", 20)], {}, [False] * 4 + [True]),
        ([("/a", 0), ("/a", 0), ("/a", 9), ("/a", 5), ("/a", 20), ("/a", 21)], {}, [True, False, False, True]),
        ([("/a", 0), ("/a", 5), ("/a", 5), ("/a", 5), ("/a", 5), ("/a", 9)], {}, [True] * 3),
    ],
    ids=["start", "end", "a topic of two", "overlapping", "out of order inside", "touching"],
)
def test_partly_copied_chunks_are_rewritten(tmp_path, items, options, expected):
    source = by_library(tmp_path / "a.mcap", items, chunk_size=TWO)
    pieces = copied(source, tmp_path / "b.mcap", **options)
    read = {"topics": options.get("topics"), "start_ns": options.get("start_ns"), "end_ns": options.get("end_ns")}
    assert inputs(tmp_path / "b.mcap") == plain(log.read(log.summarise(source), **read))
    assert whole(pieces) == expected


def test_a_chunk_that_describes_an_omitted_channel_is_rewritten(tmp_path):
    """Another channel may have its id in the copy."""
    source = by_library(tmp_path / "a.mcap", [("/b", time) for time in range(6)], chunk_size=TWO)
    pieces = copied(source, tmp_path / "b.mcap", topics=["/b"])
    assert whole(pieces)[0] is False
    assert whole(pieces)[-1] is True
    assert inputs(tmp_path / "b.mcap") == plain(log.read(log.summarise(source)))


def test_a_large_chunk_is_rewritten(tmp_path, monkeypatch):
    monkeypatch.setattr("roadperc_stream.log.indexed._MOST_WHOLE_BYTES", 100)
    pieces = copied(by_library(tmp_path / "a.mcap", IN_ORDER, chunk_size=TWO), tmp_path / "b.mcap")
    assert not any(whole(pieces))


def test_messages_without_index_entry_do_not_become_results(tmp_path):
    """The id of their undescribed channel is free for a channel of results."""
    source, hidden = tmp_path / "a.mcap", 2
    with source.open("wb") as stream:
        file, chunk = McapFile(stream, "", ""), OpenChunk()
        file.add_schema(records.Schema(1, b"s", "y", "S"))
        file.add_channel(records.Channel(A.source_id, A.topic, A.message_encoding, {}, 1))
        chunk.add(A.source_id, Message(A, 1, 1, 0, b"a"))
        chunk.add(hidden, Message(B, 1, 1, 0, b"hidden"))
        del chunk._entries[hidden]
        file.add_chunk(chunk.records())
        file.finish()
    with pytest.raises(LogError, match="message of channel 2, which the log does not describe"):
        copied(source, tmp_path / "b.mcap", topics=["/a"], results=[1])


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.sampled_from(["/a", "/b"]), st.integers(0, 30)), max_size=30),
    st.booleans(),
    st.sampled_from([1, TWO, 1000, 2**20]),
    st.lists(st.integers(0, 30), max_size=8).map(sorted),
)
def test_a_copy_of_a_copy_has_the_same_bytes(tmp_path_factory, items, in_order, chunk_size, results):
    folder = tmp_path_factory.mktemp("log")
    items = sorted(items, key=lambda item: item[1]) if in_order else items
    source = by_library(folder / "a.mcap", items, chunk_size=chunk_size)
    copied(source, folder / "b.mcap", results=results)
    pieces = copied(folder / "b.mcap", folder / "c.mcap", results=results)
    assert all(whole(pieces))
    assert inputs(folder / "b.mcap") == plain(log.read(log.summarise(source)))
    assert (folder / "b.mcap").read_bytes() == (folder / "c.mcap").read_bytes()
    assert log.audited(folder / "b.mcap").whole


def test_an_unordered_log_is_rewritten_in_separate_chunks(tmp_path):
    source = by_library(tmp_path / "a.mcap", [("/a", 7 * k % 20) for k in range(20)], use_chunking=False)
    pieces = copied(source, tmp_path / "b.mcap", results=[3, 9, 15])
    assert not any(whole(pieces))
    assert [m[1] for m in inputs(tmp_path / "b.mcap")] == list(range(20))
    index = index_of(tmp_path / "b.mcap")
    kinds = [{index.channels[i].topic for i in chunk.message_index_offsets} for chunk in index.chunk_indexes]
    assert kinds == [{"/a"}, {"/result"}] * 3 + [{"/a"}]


LATER = [(topic, time + 60) for topic, time in IN_ORDER]


@pytest.mark.parametrize(
    ("second", "options", "expected"),
    [
        (LATER, {}, True),
        ([(topic, time - 40) for topic, time in LATER], {}, False),
        ([("/b", 65)], {"schemas": (("T", "y", b""), ("S", "y", b"s"))}, False),
        ([("/a", 65)], {"schemas": (("T", "y", b""),)}, False),
    ],
    ids=["later", "meeting", "the schema's id is another", "the schema is another"],
)
def test_chunks_of_files_are_copied_if_ids_agree_and_times_do_not_overlap(tmp_path, second, options, expected):
    files = [by_library(tmp_path / "1.mcap", IN_ORDER, chunk_size=TWO)]
    files.append(by_library(tmp_path / "2.mcap", second, chunk_size=TWO, **options))
    pieces = copied(files, tmp_path / "b.mcap", results=[0, 20, 60])
    assert set(whole(pieces)) == {expected}
    assert inputs(tmp_path / "b.mcap") == plain(log.read(log.summarise(files)))
    assert log.audited(tmp_path / "b.mcap").whole
    with (tmp_path / "b.mcap").open("rb") as stream:
        kinds = {(c.topic, schema.name if schema else "") for schema, c, _ in make_reader(stream).iter_messages()}
    assert kinds - {("/a", "T")} == {("/a", "S"), ("/b", ""), ("/result", "S")}


def test_messages_of_files_without_an_index_are_copied(tmp_path):
    files = [by_library(tmp_path / "1.mcap", IN_ORDER, chunk_size=TWO)]
    files.append(by_library(tmp_path / "2.mcap", LATER, index_types=IndexType.NONE, use_statistics=False))
    pieces = copied(files, tmp_path / "b.mcap")
    assert inputs(tmp_path / "b.mcap") == plain(log.read(log.summarise(files)))
    assert whole(pieces) == [True] * 6 + [False] * 12


def test_a_growing_copy_is_read_in_log_time_order(tmp_path):
    """A copied chunk may have later messages than the results written until then."""
    source = by_library(tmp_path / "a.mcap", [("/a", 10 * k) for k in range(6)], chunk_size=2**20)
    summary = log.summarise(source)
    with LogWriter(tmp_path / "b.mcap") as writer:
        copy = MessageCopy(writer, summary.channels, log.pieces(summary, summary.channels, None, None))
        writer.register(RESULT)
        growing = writer.while_written()
        followed, seen = growing.follow(0), []
        for time in (10, 30):
            copy.through(time)
            writer.write(Message(RESULT, time, time, 0, b"r"))
            while (message := next(followed)) is not None:
                seen.append((message.channel.topic, message.log_time_ns))
            assert growing.progress() == (time, False)
            assert [m.log_time_ns for m in growing.read()] == [time for _, time in seen]
        copy.rest()
    seen += [(message.channel.topic, message.log_time_ns) for message in followed if message]
    assert seen == [
        *[("/a", 0), ("/a", 10), ("/result", 10), ("/a", 20), ("/a", 30), ("/result", 30), ("/a", 40), ("/a", 50)]
    ]
    assert growing.progress() == (50, True)


def test_new_channels_get_free_ids(tmp_path):
    last = Channel("/last", "x", source_id=65535)
    with LogWriter(tmp_path / "a.mcap") as writer:
        assert [writer.register(c, keep_ids=True) for c in (last, A)] == [65535, 1]
        assert [writer.register(c) for c in (B, RESULT, A)] == [2, 3, 1]
