"""A replay measured from outside."""

import sys
from pathlib import Path

import pytest

from roadperc_stream.errors import ProgramError
from roadperc_stream.tools.bench import __main__ as bench
from roadperc_stream.tools.bench.inputs import BenchLog
from roadperc_stream.tools.bench.replays import Installation, replay_job

HERE = Installation.of(Path(sys.executable))


def test_a_replay_gives_its_parts(bench_logs, tmp_path):
    found = replay_job("replay", HERE, bench_logs["png"], tmp_path / "out.mcap", 1).run()
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
        replay_job("replay png", HERE, missing, tmp_path / "out.mcap", 1).run()


def test_an_interpreter_without_the_package_is_refused(tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexit 7\n")
    python.chmod(0o755)
    with pytest.raises(ProgramError, match="roadperc-replay --help ended with exit code 7"):
        Installation.of(python)


def test_threads_are_asked_for_where_the_version_takes_them():
    assert Installation(Path("python"), takes_threads=True).threads(2) == ("--threads", "2")
    assert Installation(Path("python"), takes_threads=False).threads(2) == ()


def test_the_floor_comes_behind_a_replay_whose_results_it_needs(bench_logs, tmp_path):
    names = [job.name for job in bench._jobs(tmp_path, bench_logs, 2)]
    for log in ("png", "jpeg", "stereo"):
        assert names.index(f"course {log}") < names.index(f"replay {log}, one thread") < names.index(f"floor {log}")
    assert "replay truth, one thread" in names
    assert ("replay png, all threads" in names) == HERE.takes_threads


def test_the_course_runs_as_a_program_of_its_own(bench_logs):
    job = bench._course_job(bench_logs["png"], 1)
    assert {"cpu", "wall", "part/odometry"} <= set(job.run())
