"""Reading and writing logs: order, channels, CRCs, and invalid files."""

import pytest
from blake3 import blake3
from mcap.writer import CompressionType, IndexType

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.log import Attachment, Channel, LogWriter, Message, Metadata
from tests.arranged import by_us
from tests.log import flips

TEXT = Channel("/text", "json", "Text", "jsonschema", b"{}", (("a", "b"),))
BARE = Channel("/bare", "x")


def message(channel=TEXT, time=5, data=b"hello", sequence=3):
    return Message(channel, time, time + 1, sequence, data)


def write(path, messages, **extra):
    return by_us(path, messages, profile="p", **extra)


def test_a_written_log_is_read_completely(tmp_path):
    attachments = (Attachment("a.txt", "text/plain", b"x", 1, 2),)
    metadata = (Metadata("m", (("k", "v"),)),)
    path = write(tmp_path / "a.mcap", [message(), message(BARE, 9)], attachments=attachments, metadata=metadata)
    summary = log.summarise(path)
    assert (summary.profile, summary.attachments, summary.metadata) == ("p", attachments, metadata)
    assert [c.topic for c in summary.channels] == ["/text", "/bare"]
    assert list(summary.counts.values()) == [1, 1]
    assert (summary.first_ns, summary.last_ns) == (5, 9)


def test_a_failure_leaves_no_file(tmp_path):
    def fail():
        with LogWriter(tmp_path / "a.mcap") as writer:
            writer.write(message())
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_the_digest_covers_topic_schema_times_sequence_and_bytes():
    digest = log.MessageDigest()
    digest.update(Message(Channel("/a", "raw", "x.Y"), 5, 4, 3, b"hello"))
    assert digest.hexdigest() == blake3(b"/a\0x.Y\x005\x004\x003\x005\0hello").hexdigest()


def broken(tmp_path, kind):
    path = tmp_path / f"{kind}.mcap"
    whole = write(tmp_path / "whole.mcap", [message(data=bytes(500), time=t) for t in range(200)]).read_bytes()
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "text":
        path.write_bytes(b"no log at all, but long enough to hold a magic")
    elif kind == "half":
        path.write_bytes(whole[: len(whole) // 2])
    elif kind == "flipped":
        at = 200
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
    elif kind == "folder":
        path.mkdir()
    return path


def read_whole(path):
    return log.summarise(path), list(log.read(log.summarise(path)))


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("missing", "No such file"),
        ("empty", "empty file"),
        ("text", "not an MCAP log"),
        ("half", "cut off"),
        ("flipped", "damaged"),
        ("folder", "is a folder, expected a log"),
    ],
)
def test_a_path_without_a_log_gives_one_line(tmp_path, kind, words):
    path = broken(tmp_path, kind)
    with pytest.raises(LogError, match=words) as caught:
        read_whole(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert ("roadperc-info" in str(caught.value)) == (kind in {"half", "flipped"})


@pytest.mark.parametrize(
    ("name", "content", "command"),
    [
        ("drops.mp4", b"\0\0\0 ftypisom", "roadperc-convert {0}/drops.mp4 IN.mcap"),
        ("1.png", b"\x89PNG\r\n", "roadperc-convert {0} IN.mcap"),
        ("x.bag", b"#ROSBAG V2.0\n", "roadperc-replay {0}/x.bag OUT.mcap"),
        ("x.parquet", b"PAR1", "roadperc-report {0}/x.parquet"),
    ],
)
def test_the_error_for_another_file_names_its_command(tmp_path, name, content, command):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError) as caught:
        log.summarise(tmp_path / name)
    assert str(caught.value).endswith(command.format(tmp_path))


def test_the_error_for_a_damaged_log_names_roadperc_info(tmp_path):
    (tmp_path / "my logs").mkdir()
    path = broken(tmp_path / "my logs", "half")
    with pytest.raises(LogError) as caught:
        read_whole(path)
    assert str(caught.value).endswith(f"; run roadperc-info '{path}' to see what is intact")


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"index_types": IndexType.NONE}, {}])
def test_any_changed_byte_is_found(tmp_path, options):
    options |= {"enable_data_crcs": True, "compression": CompressionType.NONE}
    path = flips.write(tmp_path / "a.mcap", chunk_size=500, **options)
    whole = path.read_bytes()
    for at in range(200, len(whole) // 2, 97):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(LogError, match="damaged"):
            read_whole(path)
