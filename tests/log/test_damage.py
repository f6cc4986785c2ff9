"""Any damage: every intact message comes back in order, nothing is invented, and the lost times are reported."""

from collections import Counter
from random import Random

import lz4.frame
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.log import LostSpan, Metadata, Recovery, layout
from roadperc_stream.log.chunks import outline_of, streamed
from roadperc_stream.log.layout import chunk_head, message_head, records_in
from tests.log import flips

CRC = {"enable_crcs": True, "enable_data_crcs": True}
CHUNKED = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "not compressed": {"compression": CompressionType.NONE},
    "no index": {"compression": CompressionType.NONE, "index_types": IndexType.NONE, "use_statistics": False},
}
UNCHUNKED = {"no chunks": {}, "no chunks, no summary": {"index_types": IndexType.NONE, "use_statistics": False}}


def units(content):
    """The chunks of a log, or its messages outside chunks: first byte, end, and (channel, time, sequence, data)."""
    for record in records_in(content[8:-8]):
        found = list(streamed(chunk_head(record.body))) if record.opcode == 6 else [record]
        bodies = [bytes(item.body) for item in found if item.opcode == 5]
        heads = [message_head(body) for body in bodies]
        messages = [(h.channel_id, h.log_time_ns, h.sequence, b[22:]) for h, b in zip(heads, bodies, strict=True)]
        if messages:
            yield record.start + 8, record.end + 8, messages


@st.composite
def damages(draw, size, least):
    """Places to overwrite, and a length to cut the file at."""
    places = draw(st.lists(st.tuples(st.integers(least, size - 1), st.binary(min_size=1, max_size=60)), max_size=3))
    return places, draw(st.one_of(st.just(size), st.integers(least, size)))


def damaged(content, places, length):
    """The damaged log, and which of its bytes are intact."""
    changed, intact = bytearray(content), bytearray(b"\1" * length)
    for at, data in places:
        for k, value in enumerate(data[: len(content) - at]):
            if k + at < length and changed[at + k] != value:
                changed[at + k], intact[at + k] = value, 0
    return bytes(changed[:length]), intact


def saved(path):
    salvage = log.Salvage(path)
    found = [(m.channel.source_id, m.log_time_ns, m.sequence, m.data) for m in salvage.messages()]
    return salvage, found


def is_part(some, of):
    """Whether some items are among others in the same order."""
    rest = iter(of)
    return all(item in rest for item in some)


@pytest.mark.parametrize("shape", [*CHUNKED, *UNCHUNKED])
@settings(max_examples=60)
@given(data=st.data())
def test_every_intact_message_comes_back(tmp_path_factory, shape, data):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    options = CRC | CHUNKED.get(shape, {"use_chunking": False} | UNCHUNKED.get(shape, {}))
    content = flips.write(path, messages=30, chunk_size=700, **options).read_bytes()
    whole = list(units(content))
    places, length = data.draw(damages(len(content), whole[0][1] if shape in CHUNKED else whole[2][1]))
    changed, intact = damaged(content, places, length)
    path.write_bytes(changed)
    salvage, found = saved(path)
    expected = [messages for start, end, messages in whole if end <= length and all(intact[start:end])]
    assert is_part([m for messages in expected for m in messages], found)
    every = Counter(m for _, _, messages in whole for m in messages)
    assert len(found) <= every.total()
    unverified = [messages for start, end, messages in whole if start < length < end or shape in UNCHUNKED]
    altered = (Counter(found) - every).total()
    assert altered <= sum(map(len, unverified)) - sum(messages in unverified for messages in expected)
    for _, time_ns, _, _ in every - Counter(found) if not altered else ():
        assert any((gap.first_ns or 0) <= time_ns <= (gap.last_ns or 2**64) for gap in salvage.losses.gaps)
    if changed != content:
        assert salvage.damages
        with pytest.raises(LogError, match=f"^{path}: "):
            log.summarise(path)


@pytest.mark.parametrize("shape", flips.SHAPES)
def test_a_flipped_bit_is_an_error_or_loses_no_message(tmp_path, shape):
    """Also without any CRC."""
    path = flips.write(tmp_path / "a.mcap", messages=18, chunk_size=700, **flips.SHAPES[shape])
    whole, random, truth = path.read_bytes(), Random(shape), dict.fromkeys(flips.TOPICS, 6)
    counted = shape not in {"no index, no statistics", "unchunked, no statistics"}
    assert flips.outcome(path, truth, counted=counted) == "read"
    for _ in range(40):
        bit = random.randrange(8 * len(whole))
        path.write_bytes(flips.flipped(whole, bit))
        assert flips.outcome(path, truth, counted=counted) != "lost", f"bit {bit % 8} of byte {bit // 8}"


def repaired(path):
    target = path.with_name("repaired.mcap")
    target.unlink(missing_ok=True)
    _, recovery = log.write_repaired(path, target)
    return recovery, list(log.read(log.summarise(target))), log.summarise(target)


def test_the_start_of_a_cut_chunk_is_saved(tmp_path):
    path = flips.write(tmp_path / "a.mcap", messages=9000, chunk_size=1_000_000, **CRC)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3])
    assert 2000 < len(repaired(path)[1]) < 3600


def damaged_in_the_middle(tmp_path):
    path = flips.write(tmp_path / "a.mcap", compression=CompressionType.NONE, **CRC)
    whole, messages = path.read_bytes(), list(log.read(log.summarise(path)))
    path.write_bytes(flips.flipped(whole, 8 * whole.index(messages[30].data)))
    return path, messages


def test_a_repaired_log_tells_the_lost_times(tmp_path):
    path, before = damaged_in_the_middle(tmp_path)
    recovery, messages, summary = repaired(path)
    lost = [m.log_time_ns for m in before if m not in messages]
    assert 5 < len(lost) < 20
    assert recovery == Recovery(len(messages), (LostSpan(lost[0], lost[-1]),))
    assert Recovery.of_records(summary.metadata) == recovery
    assert [a.name for a in summary.attachments] == ["a.txt"]
    assert Metadata("notes", (("k", "v"),)) in summary.metadata


def test_a_repaired_log_that_is_damaged_again_keeps_both_losses(tmp_path, monkeypatch):
    monkeypatch.setattr("roadperc_stream.log.writing.CHUNK_SIZE_BYTES", 1500)
    first = repaired(damaged_in_the_middle(tmp_path)[0])[0]
    again, content = tmp_path / "again.mcap", (tmp_path / "repaired.mcap").read_bytes()
    again.write_bytes(flips.flipped(content, 8 * (content.index(b"zstd", len(content) // 3) + 100)))
    second = repaired(again)[0]
    assert second.gaps[0] == first.gaps[0]
    assert len(second.gaps) == 2


def test_messages_of_an_undescribed_channel_are_lost(tmp_path):
    path = flips.write(tmp_path / "a.mcap", use_chunking=False, repeat_channels=False, use_statistics=False)
    whole = path.read_bytes()
    at = whole.index(b"/depth") - 4 - 4 - 9
    path.write_bytes(whole[:at] + b"\x7f" + whole[at + 1 :])  # the channel's record is of no known type
    recovery, messages, _ = repaired(path)
    assert {m.channel.topic for m in messages} == {"/image", "/tf"}
    assert len(recovery.gaps) == 20


def test_channels_that_only_the_summary_describes_are_kept(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **CRC)
    whole = path.read_bytes()
    path.write_bytes(whole[:90] + b"\xff" * 40 + whole[130:])  # in the first chunk, which describes the channels
    _, messages, summary = repaired(path)
    assert {m.channel.topic for m in messages} == set(flips.TOPICS)
    assert {c.schema_name for c in summary.channels} == {"Text"}


def test_a_whole_log_is_copied_without_a_record_of_losses(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **CRC)
    recovery, messages, summary = repaired(path)
    assert messages == list(log.read(log.summarise(path)))
    assert (recovery.gaps, Recovery.of_records(summary.metadata)) == ((), None)


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"version": "3", "saved": "1", "gaps": "[]"},
        {"version": "2", "saved": "many", "gaps": "[]"},
        {"version": "2", "saved": "1", "gaps": '[["a", 1]]'},
        {"version": "2", "saved": "1", "gaps": "[" * 100_000},
        {"version": "2", "saved": "9" * 5000, "gaps": "[]"},
    ],
)
def test_an_invalid_record_of_losses_is_ignored(values):
    assert Recovery.of_records([Metadata("roadperc.recovery", tuple(values.items()))]) is None


def test_an_lz4_frame_without_its_end_is_an_error():
    data = b"\x05" + (50).to_bytes(8, "little") + bytes(50)
    frame = lz4.frame.compress(data, store_size=False)
    for stored, fault in ((frame, ""), (frame[:-4], layout.TOO_SHORT)):
        head = layout.ChunkHead(0, 1, len(data), 0, "lz4", len(stored), memoryview(stored))
        assert outline_of(head, 10)[1] == fault
