"""Workers that are killed: by their time, by their memory, by the system; and what they leave behind."""

import os
import signal
import subprocess
import sys

import pytest

from tests.fuzz import bounds, pool
from tests.fuzz.judge import ROOT
from tests.fuzz.pool import Order, run

WORKER = """
import json, os, resource, sys, time
print(json.dumps({"ready": True}), flush=True)
for line in sys.stdin:
    name = json.loads(line)["case"]
    if name == "never made":
        while True: pass
    print(json.dumps({"beat": True}), flush=True)
    if name == "busy":
        while True: pass
    if name == "asleep":
        time.sleep(600)
    if name == "killed":
        os.kill(os.getpid(), 9)
    verdict = {"command": "info", "codes": [0], "message": "", "faults": [], "recipe": {}, "line": name}
    print(json.dumps({"verdict": verdict}), flush=True)
"""


@pytest.fixture
def workers(tmp_path, monkeypatch):
    """Workers that do as the case is called, and have little time."""
    script = tmp_path / "worker.py"
    script.write_text(WORKER)
    started, really = [], subprocess.Popen

    def popen(words, **options):
        started.append(really([sys.executable, str(script)], **options))
        return started[-1]

    monkeypatch.setattr(pool.subprocess, "Popen", popen)
    monkeypatch.setattr(pool.Worker.begin, "__defaults__", (0.5, 3.0))
    return started


def faults(found):
    return {order.case: verdict.faults for order, verdict in found}


def test_a_worker_that_is_killed_is_replaced_and_the_others_go_on(workers):
    found = faults(run([Order(name) for name in ("a", "busy", "b", "killed", "c", "asleep", "never made", "d")], 2))
    assert found == {
        "a": [], "b": [], "c": [], "d": [], "busy": ["hang: more than 10 s"], "asleep": ["hang: more than 10 s"],
        "killed": ["died: the process ended with -9"], "never made": ["its own fault: hang: more than 10 s"],
    }  # fmt: skip
    assert all(worker.poll() is not None for worker in workers)


def test_a_worker_is_replaced_after_so_many_cases(workers, monkeypatch):
    monkeypatch.setattr(pool, "CASES_OF_A_WORKER", 2)
    assert faults(run([Order(name) for name in "abcde"], 1)) == {name: [] for name in "abcde"}
    assert [worker.poll() is not None for worker in workers] == [True] * 3


def test_who_stops_early_leaves_no_process(workers):
    found = run([Order("a"), Order("asleep")], 2)
    next(found)
    found.close()
    assert all(worker.poll() == -signal.SIGKILL for worker in workers)


def test_a_gigabyte_more_is_refused():
    code = "from tests.fuzz import bounds; bounds.limit_growth(); bytearray(2**29); bytearray(2**31)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1] == "MemoryError"
    assert bounds.MOST_GROWTH_BYTES == 2**30


def test_a_case_that_cannot_be_made_is_the_fuzzers_fault_and_the_next_one_follows(tmp_path):
    (tmp_path / "broken.json").write_text('{"family": "log", "base": "no such drive"}')
    words = [
        sys.executable,
        "-m",
        "tests.fuzz",
        "--jobs",
        "1",
        "--case",
        str(tmp_path / "broken.json"),
        "--case",
        "1:5",
    ]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode == 1, done.stderr
    assert "broken.json: ?: [None]" in done.stdout
    assert "its own fault: KeyError: 'no such drive' in cases.py:_log" in done.stdout
    assert "\n1:5: roadperc-" in done.stdout
    assert "\n2 cases in " in done.stdout
    assert "\nFAULT: 1 fuzzer: its own fault: KeyError: Q" in done.stdout


def test_the_whole_command_on_one_case():
    """As its output says it: the case is repeated by its name."""
    words = [sys.executable, "-m", "tests.fuzz", "--case", "quaternion-of-1e308-in-trajectory", "--jobs", "1"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("quaternion-of-1e308-in-trajectory: roadperc-trajectory out.metrics.parquet: [1]")
    assert "\n1 cases in " in done.stdout
