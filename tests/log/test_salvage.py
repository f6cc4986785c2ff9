"""The readable messages of a damaged log are read, and the damaged places reported."""

import pytest
from mcap.writer import CompressionType, Writer

from roadperc_stream.log import Salvage, read, summarise
from tests.info.odd import WRITERS, write

TIMES = [10 * k for k in range(1, 61)]


def salvaged(path):
    salvage = Salvage(path)
    return salvage, list(salvage.messages())


ALL_WRITERS = WRITERS | {
    "no channels in the summary": {"repeat_channels": False},
    "no schemas in the summary": {"repeat_schemas": False},
}


@pytest.mark.parametrize("options", ALL_WRITERS.values(), ids=ALL_WRITERS)
def test_logs_of_any_writer_are_not_damaged(tmp_path, options):
    salvage, messages = salvaged(write(tmp_path / "a.mcap", TIMES, **options))
    assert (salvage.whole, salvage.damages) == (True, [])
    assert [m.log_time_ns for m in messages] == TIMES
    summary = summarise(tmp_path / "a.mcap")
    assert messages == list(read(summary))
    assert ([c.schema_name for c in summary.channels], list(summary.counts.values())) == (["Text"], [len(TIMES)])


def test_a_chunk_with_a_wrong_record_length_is_read(tmp_path):
    path = write(tmp_path / "a.mcap", TIMES)
    whole = bytearray(path.read_bytes())
    at = next(k for k in range(900, len(whole)) if whole[k] == 6 and whole[k + 4 : k + 9] == bytes(5))
    whole[at + 8] = 0x7F  # the highest byte of a chunk's length
    path.write_bytes(whole)
    salvage, messages = salvaged(path)
    assert salvage.damages[0].byte == at
    assert [m.log_time_ns for m in messages] == TIMES  # the chunk contains its length


@pytest.mark.parametrize(
    ("options", "absent"),
    [
        ({"enable_data_crcs": True}, ()),
        ({"enable_data_crcs": True, **WRITERS["no index"]}, ("index",)),
        ({}, ("CRC of the data section",)),
    ],
)
def test_missing_optional_parts_are_listed(tmp_path, options, absent):
    salvage, _ = salvaged(write(tmp_path / "a.mcap", TIMES, **options))
    assert salvage.absent == absent


def test_chunks_without_crc_are_counted(tmp_path):
    salvage, _ = salvaged(write(tmp_path / "a.mcap", TIMES, enable_crcs=False))
    assert salvage.absent == ("CRC of the data section", f"CRCs of {salvage.chunks.total()} chunks")


def test_the_crc_of_the_data_section_finds_a_wrong_byte(tmp_path):
    path = write(tmp_path / "a.mcap", TIMES, use_chunking=False, enable_data_crcs=True)
    path.write_bytes(path.read_bytes().replace(b"xxxxx", b"xxyxx", 1))
    salvage, messages = salvaged(path)
    assert len(messages) == len(TIMES)
    assert "CRC of the data section" in salvage.damages[0].words


def test_changed_summaries_and_attachments_are_found(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        writer.add_attachment(1, 1, "a.txt", "text/plain", b"content")
        writer.add_metadata("notes", {"k": "v"})
        writer.finish()
    salvage, messages = salvaged(path)
    assert (salvage.whole, messages) == (True, [])
    assert [a.data for a in salvage.described.attachments] == [b"content"]
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"content", b"contend"))
    assert "CRC of the attachment" in salvaged(path)[0].damages[0].words
    at = whole.rindex(b"notes")
    path.write_bytes(whole[:at] + b"nodes" + whole[at + 5 :])
    assert "CRC of the summary" in salvaged(path)[0].damages[0].words
