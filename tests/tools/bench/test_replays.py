"""Measure programs and replays from outside."""

import sys

import pytest

from roadperc_stream.errors import ProgramError
from roadperc_stream.tools.bench.inputs import BenchLog
from roadperc_stream.tools.bench.replays import cost_of, replay_cost

pytestmark = pytest.mark.long


def test_a_replay_gives_its_parts(bench_logs, tmp_path):
    found = replay_cost("replay", bench_logs["png"], tmp_path / "out.mcap", 1)
    assert {"part/decode", "part/surface", "part/lanes", "part/objects", "part/encode", "part/total"} <= set(found)
    assert "part/sync_skew" not in found
    assert 0.5 < found["parts over total"] <= 1.5
    assert found["objects p95 over median"] >= 1
    assert found["peak_mb"] > 50
    assert found["first frame/cpu"] > 100
    assert (tmp_path / "out.mcap").exists()


def test_a_replay_that_fails_is_an_error(tmp_path):
    missing = BenchLog("png", *(tmp_path / f"{part}.mcap" for part in ("in", "warm-up", "first")), 4)
    with pytest.raises(ProgramError, match="replay png ended with exit code 1"):
        replay_cost("replay png", missing, tmp_path / "out.mcap", 1)
    with pytest.raises(ProgramError, match="the missing one could not be started"):
        cost_of("the missing one", ["/no/such/program"])


def test_memory_and_time_are_those_of_the_program_and_its_text_is_dropped(capfd):
    here = b"x" * 300_000_000  # the memory of this process does not count
    small = cost_of("small", [sys.executable, "-S", "-c", "pass"])
    large = cost_of("large", [sys.executable, "-c", "print(len(b'x' * 200_000_000)); sum(range(3_000_000))"])
    assert large.peak_mb > small.peak_mb + 190
    assert small.peak_mb < 60 < len(here)
    assert large.cpu_s > 0
    assert large.wall_s > 0
    assert capfd.readouterr().out == ""
