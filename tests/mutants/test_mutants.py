"""The mutation testing command on a small project."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants.__main__ import draw, places_in, run_tests

pytestmark = pytest.mark.long

CALC = '''"""Numbers."""

LIMIT = 3


def clipped(value: int | None = 4) -> int:
    """At most three."""
    return LIMIT if value > LIMIT else value


def halved(value):
    """Rounded up."""
    return (value + 1) // 2


def unseen(value):
    """Without a test."""
    if value == 1:
        raise ValueError(value + 7)
    return value + value * value
'''
TESTS = """import subprocess
import sys

from roadperc_stream.calc import halved


def test_halved():
    assert [halved(k) for k in (0, 7, 8)] == [0, 4, 4]


def test_clipped_in_a_process_of_its_own():
    code = "from roadperc_stream.calc import clipped; print(clipped(), clipped(2), clipped(5))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "3 2 3\\n"


def test_that_fails_without_any_fault():
    assert halved(8) == 5
"""


@pytest.fixture
def project(tmp_path, monkeypatch):
    (tmp_path / "roadperc_stream").mkdir()
    (tmp_path / "roadperc_stream" / "__init__.py").touch()
    (tmp_path / "roadperc_stream" / "calc.py").write_text(CALC)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_calc.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def mutants(project: Path, *arguments: str):
    paths = os.pathsep.join([str(project), str(Path(__file__).parents[2])])
    return subprocess.run(
        [sys.executable, "-m", "tests.mutants", "--jobs", "2", *arguments],
        cwd=project, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_unnoticed_faults_are_printed(project):
    before = {path: path.read_bytes() for path in project.rglob("*.py")}
    done = mutants(project, "--count", "5")
    *survivors, last = done.stdout.splitlines()
    assert (done.returncode, last.startswith("noticed ")) == (1, True), done.stdout + done.stderr
    unseen = CALC[: CALC.index("def unseen")].count("\n")
    lines = [int(line.split(":")[1].split()[0]) for line in survivors]
    assert {line for line in lines if line > unseen} == {unseen + 3, unseen + 5}
    assert any(line.endswith("return value - value * value   (1 test files)") for line in survivors), survivors
    assert {path: path.read_bytes() for path in project.rglob("*.py")} == before
    assert not list(project.rglob(".pytest_cache"))


def test_the_command_succeeds_if_every_fault_is_noticed(project):
    (project / "roadperc_stream" / "other.py").write_text(CALC)
    (project / "roadperc_stream" / "calc.py").write_text(
        "from roadperc_stream.other import clipped\n\n\ndef halved(value):\n    return (value + 1) // 2\n"
    )
    done = mutants(project, "--count", "3", "roadperc_stream/calc.py")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("noticed 3 of 3 (100.0%) in ")


def test_a_seed_draws_the_same_faults_at_different_places(project):
    drawn = [draw([], 5, seed) for seed in (7, 7, 8)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert len(set(drawn[0])) == 5
    with (project / "roadperc_stream" / "calc.py").open("a") as file:
        file.write("\n\ndef shown(value, *, more=2):\n    return field(value * more, repr=True)\n")
    places_in.cache_clear()
    every = draw([], 100, 7)  # none in error messages, types, texts of objects and marks of arguments
    assert not [
        fault for fault in every if ("more=2" in str(fault) and "Mul" in fault.operator) or "True" in fault.operator
    ]
    assert not [fault for fault in every if "raise" in str(fault) or "BitOr" in fault.operator]


def test_a_test_that_hangs_is_ended(project):
    (project / "tests" / "test_calc.py").write_text("import time\n\n\ndef test():\n    time.sleep(600)\n")
    assert run_tests(["tests"], str(project), 2.0) == (-9, "")


def test_a_folder_without_code_has_no_faults(project):
    done = mutants(project, "elsewhere")
    assert (done.returncode, done.stdout) == (0, "no faults to try\n")
