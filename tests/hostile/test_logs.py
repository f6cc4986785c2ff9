"""Logs with wrong declared sizes give a result or one line, in limited memory and time."""

import time

import lz4.frame
import pytest
import zstandard
from mcap.writer import IndexType, Writer

from roadperc_stream import log
from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log import Salvage
from tests.commands import run_forked
from tests.hostile import inputs

pytestmark = pytest.mark.commands
GIB = 2**30
KNOWN = (inputs.schema(1, "A", "jsonschema", b"{}"), inputs.channel(1, 1, "/a", "json"))
HUGE = 8 * GIB + 512 * 2**20
CLAIMED = 10**11


def compressed(data, compression, size=HUGE):
    return inputs.file(*KNOWN, inputs.chunk(data, compression, size=size))


CASES = {
    "zstd that declares its size": lambda: compressed(inputs.zeros_as_zstd(HUGE), "zstd"),
    "zstd in a chunk with a wrong size": lambda: compressed(inputs.zeros_as_zstd(HUGE, stated=False), "zstd", size=100),
    "lz4": lambda: compressed(inputs.lz4_zeros(HUGE), "lz4"),
    "chunk that stores 100 GB": lambda: inputs.file(*KNOWN, inputs.chunk(b"x", size=CLAIMED, length=CLAIMED)),
    "message of 100 GB": lambda: inputs.file(*KNOWN, inputs.message(1, 1, b"x" * 100, CLAIMED)),
    "attachment of 100 GB": lambda: inputs.file(*KNOWN, inputs.attachment(CLAIMED)),
}


@pytest.mark.parametrize("case", CASES)
def test_declared_sizes_are_not_allocated(tmp_path, case):
    path = tmp_path / "in.mcap"
    path.write_bytes(CASES[case]())
    for command in (("roadperc-replay", path, tmp_path / "out.mcap"), ("roadperc-info", path)):
        done = run_forked(*command, memory_bytes=inputs.GROWTH_BYTES)
        assert done.returncode == 1, done.stdout
        assert done.stderr.count("\n") == 1, done.stderr
        assert done.stderr.startswith("error: ")
        assert "not enough memory" not in done.stderr
    assert list(tmp_path.glob("*out*")) == []


MESSAGE = inputs.message(1, 1, bytes(3_000_000))
IN_A_CHUNK = b"".join((*KNOWN, MESSAGE))


@pytest.mark.parametrize(
    ("kind", "data"),
    [
        ("chunk", compressed(zstandard.compress(IN_A_CHUNK), "zstd", size=len(IN_A_CHUNK))),
        ("record", inputs.file(*KNOWN, MESSAGE)),
    ],
    ids=["chunk", "record"],
)
def test_an_error_about_a_limit_names_the_setting(tmp_path, kind, data):
    path = tmp_path / "in.mcap"
    path.write_bytes(data)
    assert [len(m.data) for m in log.read(log.summarise(path))] == [3_000_000]
    with pytest.raises(LogError, match=rf"a {kind} of 3 MiB: expected limits\.{kind}_mb 1 at most"):
        list(log.read(log.summarise(path, LimitsConfig(**{f"{kind}_mb": 1}))))


@pytest.mark.parametrize("stated", [True, False])
def test_chunks_without_a_declared_size_are_read(tmp_path, stated):
    """lz4 with and without its size; the size is measured before decompression."""
    data = b"".join(KNOWN) + b"".join(inputs.message(1, 1, bytes(50_000)) for _ in range(100))
    packed = lz4.frame.compress(data, store_size=stated)
    path = tmp_path / "in.mcap"
    path.write_bytes(compressed(packed, "lz4", size=len(data)))
    assert len(list(log.read(log.summarise(path)))) == 100
    path.write_bytes(compressed(packed, "lz4", size=len(data) - 1))
    with pytest.raises(LogError, match="holds more than"):
        list(log.read(log.summarise(path)))


@pytest.mark.parametrize("indexed", [True, False])
def test_a_chunk_with_too_many_messages_is_refused(tmp_path, monkeypatch, indexed):
    path = tmp_path / "in.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2**30, index_types=IndexType.ALL if indexed else IndexType.NONE)
        writer.start()
        channel = writer.register_channel("/a", "json", 0)
        for k in range(1000):
            writer.add_message(channel, k, b"", k)
        writer.finish()
    assert log.summarise(path).counts == {channel: 1000}
    monkeypatch.setattr(LimitsConfig, "chunk_messages", 900)
    with pytest.raises(LogError, match=r"more messages in a chunk than 900"):
        log.summarise(path)


def test_the_limits_hold_during_recovery(tmp_path):
    path = tmp_path / "in.mcap"
    bomb = inputs.chunk(inputs.zeros_as_zstd(HUGE), "zstd", size=HUGE)
    path.write_bytes(inputs.file(*KNOWN, inputs.message(1, 1, b"{}"), bomb, inputs.message(1, 2, b"{}")))
    salvage = Salvage(path)
    started = time.process_time()
    assert [m.log_time_ns for m in salvage.messages()] == [1, 2]
    assert time.process_time() - started < 5
    assert "limits.chunk_mb" in salvage.damages[0].words


def test_the_largest_64_bit_time_gives_one_line(tmp_path):
    path = tmp_path / "in.mcap"
    path.write_bytes(inputs.file(*KNOWN, inputs.message(1, 2**64 - 1, b"{}"), inputs.message(1, 5, b"{}")))
    assert "2 messages on 1 channel" in run_forked("roadperc-info", path).stdout
    done = run_forked("roadperc-replay", path, tmp_path / "out.mcap")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
