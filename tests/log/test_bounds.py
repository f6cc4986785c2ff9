"""Hostile or broken input takes linear time, limited memory and disk, and gives one line."""

import os
import struct
import time
from random import Random

import pytest

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.input.source import LossTimes
from roadperc_stream.log import LostSpan
from tests.test_sample import SAMPLE


def test_a_pipe_without_mcap_is_refused_by_its_first_bytes(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = os.open(pipe, os.O_RDWR)  # never closed: waiting for more would not end
    os.write(writer, b"y\n" * 4)
    with pytest.raises(LogError, match="pipe: not an MCAP log"):
        log.received([pipe])
    os.close(writer)


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
