"""Every case of the corpus and random cases end with a result or one clear line.

For more random cases: make fuzz N=20000.
"""

import re
import subprocess
import sys

import pytest

from tests.commands import run_forked
from tests.fuzz.cases import recorded
from tests.fuzz.judge import ROOT

pytestmark = pytest.mark.long

DRAWN = 200


def fuzz(*words):
    return run_forked("tests.fuzz.__main__", *words)


def test_the_corpus_and_random_cases_find_no_fault():
    done = fuzz("--count", DRAWN)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"\n{len(recorded()) + DRAWN} cases in " in f"\n{done.stdout}"
    assert int(re.search(r"(\d+) with a result", done.stdout)[1]) > DRAWN / 4


def test_a_case_is_repeated_by_name_and_an_invalid_recipe_is_a_fault_of_the_fuzzer(tmp_path):
    broken = tmp_path / "broken.json"
    broken.write_text('{"family": "log", "base": "no such drive"}')
    done = fuzz("--case", broken, "--case", "quaternion-of-1e308-in-trajectory", "--jobs", 1)
    assert done.returncode == 1, done.stderr
    assert "broken.json: ?: None" in done.stdout
    assert "its own fault: KeyError: 'no such drive' in cases.py:_log" in done.stdout
    assert "\nquaternion-of-1e308-in-trajectory: roadperc-trajectory out.metrics.parquet: 1" in done.stdout
    assert "\n2 cases in " in done.stdout
    assert "\nFAULT: 1 fuzzer: its own fault: KeyError: Q" in done.stdout


FORKED = """
import os, signal, sys, time
from pathlib import Path
from tests.fuzz import trying
from tests.fuzz.cases import Case

def prepared(case, folder):
    if case.name == "never made": os.kill(os.getpid(), signal.SIGALRM)
    return ["info", case.name], {}

def info():
    name = sys.argv[1]
    if name == "busy":
        while True: pass
    if name == "asleep": time.sleep(60)
    if name == "killed": os.kill(os.getpid(), 9)
    if name == "large": bytearray(2**29); bytearray(2**31)
    return 0

trying.prepared, trying.launch.info, trying.CPU_S, trying.WALL_S = prepared, info, 1, 5
names = ["a", "busy", "killed", "asleep", "never made", "large", "b"]
found = {case.name: verdict.faults for case, verdict in trying.run(map(Case, names), 2)}
print(found)
"""


def test_time_and_memory_of_a_case_are_limited_and_the_others_continue():
    done = subprocess.run([sys.executable, "-c", FORKED], cwd=ROOT, capture_output=True, text=True, check=False)
    found = eval(done.stdout)
    assert found.pop("large")[0].startswith("traceback: MemoryError")
    assert found == {
        "a": [], "b": [], "busy": ["hang: more than 1 s"], "asleep": ["hang: more than 1 s"],
        "killed": ["died: the process ended with -9"], "never made": ["its own fault: hang: more than 1 s"],
    }, done.stderr  # fmt: skip
