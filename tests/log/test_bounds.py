"""Hostile or broken input takes linear time, limited memory and disk, and gives one line."""

import os
import shutil
import struct
import time
from random import Random
from types import SimpleNamespace

import pytest

from roadperc_stream import log
from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.input.source import LossTimes
from roadperc_stream.log import Attachment, Channel, LostSpan, Message, Metadata
from roadperc_stream.log.sorting import SortedMessages
from tests.arranged import by_us
from tests.log.test_pipes import fed
from tests.test_sample import SAMPLE

MIB = 1024**2


A = Channel("/a", "x", source_id=1)


def written(path, attachments=(), metadata=()):
    messages = [Message(A, k, k, 0, b"x" * 100) for k in range(10)]
    return by_us(path, messages, attachments=attachments, metadata=metadata)


def test_a_pipe_without_mcap_is_refused_by_its_first_bytes(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = os.open(pipe, os.O_RDWR)  # never closed: waiting for more would not end
    os.write(writer, b"y\n" * 4)
    with pytest.raises(LogError, match="pipe: not an MCAP log"):
        log.received([pipe])
    os.close(writer)


def test_a_pipe_leaves_a_tenth_of_the_free_space(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=2 * MIB))
    with pytest.raises(TargetError, match=r"pipe: cannot be stored in .*: 90% of the free space are used; TMPDIR"):
        log.received([fed(tmp_path / "pipe", SAMPLE.read_bytes())])


def test_a_repaired_copy_never_has_a_name(tmp_path, monkeypatch):
    source = tmp_path / "cut.mcap"
    source.write_bytes(SAMPLE.read_bytes()[:2_000_000])
    temporary, seen = tmp_path / "temporary", []
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    complete = log.LogWriter.complete

    def watched(writer):
        seen.append(list(temporary.iterdir()))
        complete(writer)

    monkeypatch.setattr(log.LogWriter, "complete", watched)
    copy = log.repaired_copy(log.LogFile.of(source))
    repaired = tmp_path / "repaired.mcap"
    log.write_repaired(source, repaired)
    assert seen == [[], []]
    assert (list(temporary.iterdir()), sorted(tmp_path.iterdir())) == ([], sorted([source, repaired, temporary]))
    with copy.file.path.open("rb") as stream:
        assert stream.read() == repaired.read_bytes()


def test_a_read_error_of_a_sorted_log_names_the_folder():
    """The garbage collector may close the database before its reader."""
    source = SortedMessages("a.mcap", lambda: [Message(A, k, k, 0, b"x") for k in (2, 1)])
    assert [m.log_time_ns for m in source.messages(None, None, None)] == [1, 2]
    reading = source.messages(None, None, None)
    next(reading)
    source._database.close()
    reading.close()
    with pytest.raises(TargetError, match=r"a\.mcap: cannot be sorted in /.*TMPDIR names a folder"):
        list(source.messages(None, None, None))


def chunk_like(length):
    head = struct.pack("<QQQII", 0, 5, 100, 0, 0)
    return (b"\x06" + struct.pack("<Q", 200) + head + struct.pack("<Q", 160)) * (length // 45)


def message_like(length):
    return (b"\x05" + struct.pack("<Q", 60) + b"\0\0") * (length // 11)


@pytest.mark.parametrize(("junk", "length"), [(chunk_like, 4_000_000), (message_like, 20_000_000)])
def test_bytes_that_look_like_records_take_linear_time(tmp_path, junk, length):
    path = tmp_path / "junk.mcap"
    path.write_bytes(SAMPLE.read_bytes()[:60_000] + junk(length))
    salvage, started = log.Salvage(path), time.process_time()
    salvage.run()
    assert time.process_time() - started < 10
    assert not salvage.whole


def test_many_damages_are_counted_but_not_listed(tmp_path):
    path = tmp_path / "junk.mcap"
    path.write_bytes(SAMPLE.read_bytes()[:60_000] + chunk_like(600_000))
    salvage = log.audited(path)
    assert len(salvage.damages) == 1000
    assert {damage.number for damage in salvage.damages[:-1]} == {1}
    assert log.number_of(salvage.damages) == 999 + salvage.damages[-1].number > 1500
    assert salvage.damages[-1].concerns(None, None)
    with pytest.raises(LogError, match=rf"the first of {log.number_of(salvage.damages)} damages"):
        log.summarise(path)


def plain_reason(gaps, since_ns, until_ns):
    """The same result from a search through all gaps."""
    found = [
        (float("-inf") if g.first_ns is None else g.first_ns, float("inf") if g.last_ns is None else g.last_ns)
        for g in gaps
    ]
    found = [(first, last) for first, last in found if first <= until_ns and (since_ns is None or last > since_ns)]
    return (min(first for first, _ in found), max(last for _, last in found)) if found else None


def test_overlapping_gaps_are_found():
    random = Random(3)
    for _ in range(300):
        gaps = [
            LostSpan(random.choice([None, first]), random.choice([None, last, last, last]))
            for first, last in (sorted(random.choices(range(30), k=2)) for _ in range(random.randrange(6)))
        ]
        since = random.choice([None, *range(30)])
        until = random.randrange(since or 0, 31)
        reason, expected = LossTimes(gaps).reason(since, until), plain_reason(gaps, since, until)
        assert (reason is None) == (expected is None)
        if reason is not None:
            assert reason.values == tuple(ns for ns in expected if abs(ns) < float("inf"))


def test_attachments_together_have_a_limit(tmp_path):
    half = [Attachment(name, "x", bytes([k]) * (MIB * 6 // 10)) for k, name in enumerate("ab")]
    one, other = written(tmp_path / "1.mcap", half[:1]), written(tmp_path / "2.mcap", half[1:])
    both = written(tmp_path / "both.mcap", half)
    limits = LimitsConfig(record_mb=1)
    assert log.summarise(one, limits).attachments == (half[0],)
    assert len(log.summarise(both, LimitsConfig(record_mb=2)).attachments) == 2
    expected = r"attachments and metadata of 1 MiB: expected limits\.record_mb 1 at most"
    with pytest.raises(LogError, match=rf"both\.mcap: {expected}"):
        log.summarise(both, limits)
    with pytest.raises(LogError, match=rf"2\.mcap: {expected}"):
        log.summarise([one, other], limits)
    described = [Metadata(f"m{k}", (("k", "x" * (MIB * 6 // 10)),)) for k in range(2)]
    with pytest.raises(LogError, match=expected):
        log.summarise(written(tmp_path / "m.mcap", metadata=described), limits)
