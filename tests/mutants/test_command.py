"""The whole command on a small project of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants.__main__ import sample
from tests.mutants.faults import faults_in

CALC = '''"""Numbers."""

LIMIT = 3


def clipped(value):
    """At most three."""
    return min(value, LIMIT)


def halved(value):
    """By subtraction."""
    times = 0
    while value > times:
        value -= 1
        times += 1
    return times


def unseen(value):
    """Nobody tests this."""
    return value + value * value
'''
TESTS = """import subprocess
import sys

import pytest

from roadperc_stream.calc import halved


@pytest.fixture(scope="module")
def eight():
    return halved(8)


def test_another():
    pass


def test_halved(eight):
    assert eight == 4


def test_clipped_in_a_process_of_its_own():
    code = "from roadperc_stream.calc import clipped; print(clipped(2), clipped(5))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "2 3\\n"


def test_that_fails_without_any_fault():
    assert halved(8) == 5
"""


@pytest.fixture
def project(tmp_path):
    (tmp_path / "roadperc_stream").mkdir()
    (tmp_path / "roadperc_stream" / "__init__.py").touch()
    (tmp_path / "roadperc_stream" / "calc.py").write_text(CALC)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_calc.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    return tmp_path


def mutants(project: Path, *arguments: str):
    paths = os.pathsep.join([str(project), str(Path(__file__).parents[2])])
    return subprocess.run(
        [sys.executable, "-m", "tests.mutants", "--jobs", "2", *arguments],
        cwd=project, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_what_no_test_notices_is_named(project):
    before = {path: path.read_bytes() for path in project.rglob("*.py")}
    done = mutants(project, "--seed", "1")
    lines = done.stdout.splitlines()
    assert done.returncode == 1, done.stderr
    assert "left out, for it fails without any fault: tests/test_calc.py::test_that_fails_without_any_fault" in lines
    survivors = [line for line in lines if line.startswith("roadperc_stream/")]
    assert sorted(line.partition("   (")[0] for line in survivors) == [
        "roadperc_stream/calc.py:13 0 -> -1",
        "roadperc_stream/calc.py:22 value * value -> value / value",
        "roadperc_stream/calc.py:22 value + value * value -> value - value * value",
    ]
    assert lines[-1].startswith("noticed 5 of 8")
    assert {path: path.read_bytes() for path in project.rglob("*.py")} == before
    assert not list(project.rglob(".pytest_cache"))

    again = mutants(project, "--seed", "1", "--again").stdout.splitlines()
    assert sorted(again[:-1]) == sorted(survivors)
    assert again[-1].startswith(f"noticed 0 of {len(survivors)}")


def test_where_all_is_noticed_the_command_succeeds(project):
    calc = project / "roadperc_stream" / "calc.py"
    calc.write_text("def clipped(value):\n    return min(value, 3)\n\n\ndef halved(value):\n    return value // 2\n")
    done = mutants(project, "--verbose", "--count", "4")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "noticed 4 of 4 (100.0%)" in done.stdout
    assert "value // 2 -> value * 2 by tests/test_calc.py::test_halved" in done.stdout


def test_the_same_seed_draws_the_same_faults_each_at_another_place():
    places = faults_in("roadperc_stream/calc.py", CALC)
    drawn = [sample(places, 5, seed) for seed in (7, 7, 8)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert len({fault.place for fault in drawn[0]}) == 5
    assert len(sample(places, 1000, 7)) == len(places)


def test_a_folder_without_code_has_no_faults(project):
    done = mutants(project, "elsewhere")
    assert (done.returncode, done.stdout) == (0, "no faults to try\n")
