"""A damaged log gives every whole message in order, and reports the lost ones."""

import io
from random import Random

import lz4.frame
import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.log import Metadata, Recovery
from roadperc_stream.log.chunks import contents_of, unpacked
from roadperc_stream.log.damage import Damage
from roadperc_stream.log.framing import Framing
from roadperc_stream.log.layout import ChunkHead, chunk_head
from roadperc_stream.log.salvage import Salvage
from tests.fuzz.records import put_together, taken_apart
from tests.log import flips

CRC = {"enable_crcs": True, "enable_data_crcs": True}
CUT_SHAPES = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "no index": {"compression": CompressionType.NONE, "index_types": IndexType.NONE},
    "unchunked": {"use_chunking": False},
}
CUTS = 40
"""Of each shape: 200 in all."""


def repaired(path):
    target = path.with_name("repaired.mcap")
    target.unlink(missing_ok=True)
    _, recovery = log.write_repaired(path, target)
    return recovery, list(log.read(log.summarise(target))), log.summarise(target)


def ends(path):
    """Return the log time of every message of a whole log, and the byte after which it is complete.

    A message in a compressed chunk is complete at the end of the chunk, any other one at its own end.
    """
    found = []
    with path.open("rb") as stream:
        stream.read(8)
        stream.seek(0)
        for record in Framing(path.stat().st_size).records(stream):
            if record.opcode == 5:
                found.append((int.from_bytes(record.body[6:14], "little"), record.end))
            elif record.opcode == 6:
                head = chunk_head(record.body)
                start = record.end - head.stored_bytes
                for item in contents_of(head, 10_000)[0]:
                    end = record.end if head.compression else start + item.start + 9 + len(item.body)
                    if item.opcode == 5:
                        found.append((int.from_bytes(item.body[6:14], "little"), end))
    return found


@pytest.mark.parametrize("shape", CUT_SHAPES)
def test_a_cut_log_gives_every_whole_message(tmp_path, shape):
    path = flips.write(tmp_path / "a.mcap", **CRC | CUT_SHAPES[shape])
    whole, truth, random = path.read_bytes(), ends(path), Random(shape)
    for length in random.sample(range(60, len(whole)), CUTS):
        path.write_bytes(whole[:length])
        expected = [time_ns for time_ns, end in truth if end <= length]
        if not expected:
            with pytest.raises(LogError, match="no message can be saved"):
                repaired(path)
            continue
        _, messages, summary = repaired(path)
        times = [m.log_time_ns for m in messages]
        assert times[: len(expected)] == expected, length
        assert shape in {"zstd", "lz4"} or times == expected
        assert summary.first_ns == expected[0]


def test_the_start_of_a_cut_chunk_is_saved(tmp_path):
    path = flips.write(tmp_path / "a.mcap", messages=9000, chunk_size=1_000_000, **CRC)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3])
    _, messages, _ = repaired(path)
    assert 2000 < len(messages) < 3600


def damaged_in_the_middle(tmp_path, **options):
    """A log whose third chunk has a wrong byte, and the messages of that chunk."""
    path = flips.write(tmp_path / "a.mcap", **CRC | {"compression": CompressionType.NONE} | options)
    whole, messages = path.read_bytes(), list(log.read(log.summarise(path)))
    at = whole.index(messages[30].data)
    path.write_bytes(flips.flipped(whole, 8 * at))
    return path, messages


def test_a_damaged_chunk_loses_its_messages_and_they_are_reported(tmp_path):
    path, before = damaged_in_the_middle(tmp_path)
    recovery, messages, summary = repaired(path)
    lost = [m for m in before if m.log_time_ns not in {m.log_time_ns for m in messages}]
    (gap,) = recovery.gaps
    assert before[30] in lost
    assert 5 < len(lost) < 20
    assert (gap.first_ns, gap.last_ns) == (lost[0].log_time_ns, lost[-1].log_time_ns)
    assert recovery.exact
    assert recovery.saved == len(messages) == 60 - len(lost)
    assert recovery.lost == gap.messages == {t: sum(m.channel.topic == t for m in lost) for t in flips.TOPICS}
    assert Recovery.of_records(summary.metadata) == recovery
    assert [a.name for a in summary.attachments] == ["a.txt"]
    assert Metadata("notes", (("k", "v"),)) in summary.metadata


def test_without_an_index_the_next_chunk_is_found(tmp_path):
    options = {"compression": CompressionType.NONE, "index_types": IndexType.NONE, "use_statistics": False}
    path = flips.write(tmp_path / "a.mcap", **options)
    before = list(log.read(log.summarise(path)))
    content = bytearray(path.read_bytes())
    starts = [k for k in range(100, len(content)) if content[k] == 6 and content[k + 4 : k + 9] == bytes(5)]
    content[starts[2]] = 0x77  # no record has this type
    path.write_bytes(content)
    recovery, messages, _ = repaired(path)
    times = {m.log_time_ns for m in messages}
    lost = [m.log_time_ns for m in before if m.log_time_ns not in times]
    (gap,) = recovery.gaps
    assert messages[-1].log_time_ns == before[-1].log_time_ns
    assert lost == list(range(lost[0], lost[-1] + 1, flips.STEP_NS))
    assert 5 < len(lost) < 20
    assert gap.first_ns <= lost[0]
    assert lost[-1] <= gap.last_ns < lost[-1] + flips.STEP_NS
    assert not recovery.exact


def test_unchunked_messages_are_found_after_an_invalid_length(tmp_path):
    path = flips.write(tmp_path / "a.mcap", use_chunking=False)
    whole, messages = path.read_bytes(), list(log.read(log.summarise(path)))
    at = whole.index(messages[10].data) - 22 - 8
    path.write_bytes(whole[:at] + b"\x7f" * 8 + whole[at + 8 :])
    recovery, saved, _ = repaired(path)
    assert saved == messages[:10] + messages[11:]
    (gap,) = recovery.gaps
    assert gap.first_ns <= messages[10].log_time_ns <= gap.last_ns < messages[11].log_time_ns


def test_zeros_in_the_middle_lose_only_their_messages(tmp_path):
    path = flips.write(tmp_path / "a.mcap", index_types=IndexType.NONE, **NO_STATISTICS)
    whole = path.read_bytes()
    third = len(whole) // 3
    path.write_bytes(whole[:third] + bytes(third) + whole[2 * third :])
    _, messages, _ = repaired(path)
    times = [(m.log_time_ns - flips.FIRST_NS) // flips.STEP_NS for m in messages]
    assert times[0] == 0
    assert times[-1] == 59
    assert 18 <= len(times) <= 42  # two thirds, minus a chunk at each end


NO_STATISTICS = {"use_statistics": False}


def test_messages_of_an_undescribed_channel_are_reported(tmp_path):
    path = flips.write(tmp_path / "a.mcap", use_chunking=False, repeat_channels=False, use_statistics=False)
    whole = path.read_bytes()
    at = whole.index(b"/depth") - 4 - 4 - 9
    path.write_bytes(whole[:at] + b"\x7f" + whole[at + 1 :])  # the channel's record is of no known type
    recovery, messages, _ = repaired(path)
    assert {m.channel.topic for m in messages} == {"/image", "/tf"}
    assert recovery.lost == {"channel 2": 20}
    assert not recovery.exact


def test_channels_that_only_the_index_describes_are_kept(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **CRC)
    whole = path.read_bytes()
    path.write_bytes(whole[:90] + b"\xff" * 40 + whole[130:])  # in the first chunk, which describes the channels
    _, messages, summary = repaired(path)
    assert {m.channel.topic for m in messages} == set(flips.TOPICS)
    assert {c.schema_name for c in summary.channels} == {"Text"}


def test_unordered_messages_are_sorted(tmp_path):
    path = tmp_path / "a.mcap"
    channel = log.Channel("/a", "x")
    with log.LogWriter(path) as writer:
        for time_ns in (3, 1, 2, 5, 4):
            writer.write(log.Message(channel, time_ns, time_ns, 0, b"x"))
    messages = [m.log_time_ns for m in log.Salvage(path).messages()]
    target = tmp_path / "b.mcap"
    log.write_repaired(path, target)
    assert messages == [3, 1, 2, 5, 4]
    assert [m.log_time_ns for m in log.Salvage(target).messages()] == [1, 2, 3, 4, 5]


def test_a_whole_log_is_copied_without_a_record_of_losses(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **CRC)
    recovery, messages, summary = repaired(path)
    assert messages == list(log.read(log.summarise(path)))
    assert (recovery.lost, recovery.gaps) == ({}, ())
    assert Recovery.of_records(summary.metadata) is None


def test_a_repaired_log_that_is_damaged_again_keeps_both_losses(tmp_path, monkeypatch):
    monkeypatch.setattr("roadperc_stream.log.writing.CHUNK_SIZE_BYTES", 1500)
    path, _ = damaged_in_the_middle(tmp_path)
    first, _, _ = repaired(path)
    again = tmp_path / "again.mcap"
    content = (tmp_path / "repaired.mcap").read_bytes()
    at = content.index(b"zstd", len(content) // 3) + 100  # in a chunk in the middle
    again.write_bytes(flips.flipped(content, 8 * at))
    second, _, _ = repaired(again)
    assert second.gaps[0] == first.gaps[0]
    assert len(second.gaps) == 2
    assert sum(second.lost.values()) > sum(first.lost.values())


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"version": "2"},
        {"version": "1", "saved": "many", "lost": "{}", "exact": "true", "gaps": "[]"},
        {"version": "1", "saved": "1", "lost": "[]", "exact": "true", "gaps": "[]"},
        {"version": "1", "saved": "1", "lost": "{}", "exact": "true", "gaps": '[["a", 1, {}]]'},
        {"version": "1", "saved": "1", "lost": "{}", "exact": "true", "gaps": "[" * 100_000},
        {"version": "1", "saved": "9" * 5000, "lost": "{}", "exact": "true", "gaps": "[]"},
    ],
)
def test_an_invalid_record_of_losses_is_ignored(values):
    assert Recovery.of_records([Metadata("roadperc.recovery", tuple(values.items()))]) is None


def test_channels_are_taken_from_an_index_with_a_wrong_crc(tmp_path):
    """The chunk that describes them and the statistics are damaged, so only the index has the channels."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=100)
    writer.start()
    channel = writer.register_channel("/a", "json", writer.register_schema("A", "jsonschema", b"{}"))
    for k in range(20):
        writer.add_message(channel, k, b"x" * 60, k)
    writer.finish()
    records = taken_apart(stream.getvalue())
    chunk = next(record for record in records if record.opcode == Opcode.CHUNK)
    chunk.held.add("records")
    chunk.fields["records"] = chunk.fields["records"][:20] + b"?" + chunk.fields["records"][21:]
    statistics = next(record for record in records if record.opcode == Opcode.STATISTICS)
    statistics.fields["end"] += 1
    path = tmp_path / "a.mcap"
    path.write_bytes(put_together(records, "nothing"))
    salvage = Salvage(path)
    assert [message.log_time_ns for message in salvage.messages()] == list(range(len(chunk.inner) - 2, 20))
    assert not salvage.losses.undescribed


def test_an_lz4_frame_without_its_end_is_an_error():
    data = b"a record" * 100
    frame = lz4.frame.compress(data, store_size=False)
    assert bytes(unpacked(head_of(frame, len(data)), check_crc=True).data) == data
    with pytest.raises(ValueError, match="ends before its contents do"):
        unpacked(head_of(frame[:-4], len(data)), check_crc=True)


def head_of(stored, size_bytes):
    return ChunkHead(0, 1, size_bytes, 0, "lz4", len(stored), memoryview(stored))


def test_many_damages_keep_their_times():
    framing = Framing(10, (), lambda _: False)
    for k in range(1500):
        framing.note(Damage(k, "x", 1000 + k, 2000 + k))
    assert (len(framing.damages), sum(damage.number for damage in framing.damages)) == (1000, 1500)
    assert not framing.damages[-1].concerns(0, 1000)
    assert (framing.damages[-1].first_ns, framing.damages[-1].last_ns) == (1999, 3499)
