"""A flipped bit never loses a message silently, in any shape of log."""

from random import Random

import pytest

from roadperc_stream import log
from roadperc_stream.errors import LogError
from tests.log import flips

TRUTH = dict.fromkeys(flips.TOPICS, 6)
FLIPS = 40
"""Of each shape: 400 in all."""
UNCOUNTED = {"no index, no statistics", "unchunked, no statistics"}
"""Shapes that do not count the messages of a channel."""


@pytest.mark.parametrize("shape", flips.SHAPES)
def test_a_flipped_bit_is_an_error_or_loses_no_message(tmp_path, shape):
    path = flips.write(tmp_path / "a.mcap", messages=18, chunk_size=700, **flips.SHAPES[shape])
    whole, random = path.read_bytes(), Random(shape)
    counted = shape not in UNCOUNTED
    assert flips.outcome(path, TRUTH, counted=counted) == "read"
    for _ in range(FLIPS):
        bit = random.randrange(8 * len(whole))
        path.write_bytes(flips.flipped(whole, bit))
        assert flips.outcome(path, TRUTH, counted=counted) != "lost", f"bit {bit % 8} of byte {bit // 8}"


def chunk_starts(path):
    """First bytes of the chunks of a log, by its index."""
    salvage = log.Salvage(path)
    salvage.run()
    assert salvage.whole
    return [entry.chunk_start_offset for entry in salvage.index.chunk_indexes]


def refused(path, content):
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        log.summarise(path)
    assert str(path) in str(caught.value)
    return str(caught.value)


def replaced(content, old, new, which=-1):
    """The content with one occurrence of some bytes replaced, the last one by default."""
    places = [k for k in range(len(content)) if content.startswith(old, k)]
    at = places[which]
    return content[:at] + new + content[at + len(old) :]


def little(number, width=8):
    return number.to_bytes(width, "little")


@pytest.fixture
def plain(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **flips.SHAPES["uncompressed"])
    return path, path.read_bytes()


def test_a_wrong_or_repeated_index_entry_is_damage(plain):
    path, content = plain
    first, second = chunk_starts(path)[:2]
    assert "another" not in (words := refused(path, replaced(content, little(second), little(second + 1))))
    assert f"the index puts a chunk at byte {second + 1}, where no chunk starts" in words
    words = refused(path, replaced(content, little(second), little(first)))
    assert f"the index names the chunk at byte {first} more than once" in words


def test_a_log_time_outside_the_span_of_its_chunk_is_damage(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **flips.SHAPES["no index, no statistics"])
    content = path.read_bytes()
    time_ns = flips.FIRST_NS + 20 * flips.STEP_NS
    changed = replaced(content, little(time_ns) * 2, little(time_ns - flips.STEP_NS * 1000) + little(time_ns))
    assert "its chunk states" in refused(path, changed)


def test_wrong_counts_in_the_statistics_are_damage(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **flips.SHAPES["unchunked"])
    content = path.read_bytes()
    head = little(60) + little(1, 2) + little(3, 4)  # messages, schemas, channels
    assert "60 messages found, the statistics count 61" in refused(path, replaced(content, head, little(61) + head[8:]))
    channel = little(2, 2) + little(20)
    words = refused(path, replaced(content, channel, channel[:2] + little(19)))
    assert "20 messages found on channel 2, the statistics count 19" in words


def test_a_changed_opcode_of_a_message_is_damage(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **flips.SHAPES["unchunked, no statistics"])
    content, data = path.read_bytes(), [m.data for m in log.read(log.summarise(path))]
    at = content.index(data[30]) - 22 - 9
    assert content[at] == 5
    for opcode in (0x85, 0x04, 0x07, 0x01, 0x0D, 0x15, 0x45):
        refused(path, content[:at] + bytes([opcode]) + content[at + 1 :])


def test_a_private_record_is_not_damage(tmp_path):
    path = flips.write(tmp_path / "a.mcap", **flips.SHAPES["unchunked, no statistics"])
    content = path.read_bytes()
    at = content.rindex(b"\x0f" + little(4))  # the data section's end
    own = b"\x85" + little(30) + b"my own record, of thirty bytes"
    path.write_bytes(content[:at] + own + content[at:])
    with path.open("rb+") as stream:  # the footer says where the summary starts
        footer = path.stat().st_size - 8 - 29
        stream.seek(footer + 9)
        start = int.from_bytes(stream.read(8), "little")
        stream.seek(footer + 9)
        stream.write(little(start + len(own)))
    assert sum(log.summarise(path).counts.values()) == 60


def test_a_wrong_offset_in_the_footer_is_damage(plain):
    path, content = plain
    footer = len(content) - 8 - 29
    start = int.from_bytes(content[footer + 9 : footer + 17], "little")
    for wrong in (0, start + 1, start - 13):
        words = refused(path, content[: footer + 9] + little(wrong) + content[footer + 17 :])
        assert "the summary starts at byte" in words


def test_the_error_for_a_damaged_chunk_has_its_place_and_the_option(tmp_path):
    path = flips.write(tmp_path / "a.mcap", enable_crcs=True, enable_data_crcs=True)
    content = path.read_bytes()
    first = chunk_starts(path)[2]
    words = refused(path, flips.flipped(content, 8 * (first + 200)))
    assert f"damaged at byte {first}: chunk: " in words
    assert " of 60 messages can be saved, all before 0." in words
    assert "--recover" in words
    assert words.endswith(f"run roadperc-info {path} to see what is intact")
    salvage = log.Salvage(path)
    salvage.run()
    (damage,) = salvage.damages
    assert (damage.byte, damage.first_ns is None, damage.last_ns is None) == (first, False, False)
    assert damage.concerns(damage.last_ns, None)
    assert not damage.concerns(damage.last_ns + 1, None)
    assert not damage.concerns(None, damage.first_ns)
