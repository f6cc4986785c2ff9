"""One fault's trial: the tests that are nearest to it, run with the fault in place."""

import importlib.util
import json
import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePath

import hypothesis
import pytest

from tests.mutants import forks
from tests.mutants.faults import Fault
from tests.mutants.reach import Reach, TimedTest, quietly

HOOK = Path(__file__).parent / "hook"
PATIENCE_S = 60.0
PATIENCE_FACTOR = 8.0
FIRST_CASES, FIRST_FILES = 3, 2
UNNOTICED = {pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED}
NOTICED_BY = "noticed_by"
RECORDED = "recorded"


@dataclass(frozen=True)
class Trial:
    """A fault and the tests to run with it, the nearest first."""

    fault: Fault
    tests: tuple[TimedTest, ...]

    @property
    def patience_s(self) -> float:
        """How long one test may take until it hangs, on a machine that may do other work as well."""
        return PATIENCE_S + PATIENCE_FACTOR * max((test.seconds for test in self.tests), default=0.0)


def planned(fault: Fault, reaches: Iterable[Reach], budget_s: float) -> Trial:
    """The trial of a fault: of the tests that execute it the nearest, as many as fit into the budget, at least one.

    Near is first a test whose file is named after the module, then the first few cases of a test, then a quick one.
    What stands outside functions is executed when it is imported: there the tests count that execute anything in the
    module, or import it.
    """
    found: set[TimedTest] = set()
    for reach in reaches:
        here = reach.on(fault.path, fault.first_line, fault.last_line) if fault.in_function else set()
        found |= here
    if not found:
        found = {test for reach in reaches for test in reach.anywhere_in(fault.path)}
    return Trial(fault, tuple(_within(_nearest_first([test for test in found if test.passed], fault.path), budget_s)))


def _nearest_first(tests: list[TimedTest], path: str) -> list[TimedTest]:
    cases: Counter[str] = Counter()
    keys = {}
    for test in sorted(tests, key=lambda test: (test.seconds, test.nodeid)):
        name = test.nodeid.partition("[")[0]
        cases[name] += 1
        keys[test] = not _mirrors(test.file, path), cases[name] > FIRST_CASES, test.seconds, test.nodeid
    return sorted(tests, key=keys.__getitem__)


def _mirrors(test_file: str, path: str) -> bool:
    """Whether a test file is named after a module or its package, or holds a package above it to a recording."""
    name = PurePath(test_file).stem.removeprefix("test_")
    if name == RECORDED:
        return PurePath(test_file).parent.name in PurePath(path).parts
    return name in {PurePath(path).stem, PurePath(path).parent.name}


def _within(tests: list[TimedTest], budget_s: float) -> list[TimedTest]:
    chosen, spent = [], 0.0
    for test in tests:
        if not chosen or spent + test.seconds <= budget_s:
            chosen.append(test)
            spent += test.seconds
    return chosen


def in_parts(tests: tuple[TimedTest, ...]) -> list[tuple[TimedTest, ...]]:
    """The tests of the first few files, then those of all others: most faults are noticed before those are imported."""
    first = list(dict.fromkeys(test.file for test in tests))[:FIRST_FILES]
    parts = [tuple(test for test in tests if (test.file in first) == near) for near in (True, False)]
    return [part for part in parts if part]


@dataclass(eq=False)  # pytest hashes its plugins
class Chosen:
    """A pytest plugin: runs the given tests alone, in their order, and says which one failed."""

    tests: tuple[TimedTest, ...]
    folder: Path
    order: dict[str, int] = field(init=False)

    def __post_init__(self) -> None:
        self.order = {test.nodeid: position for position, test in enumerate(self.tests)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        items[:] = sorted(
            (item for item in items if item.nodeid in self.order), key=lambda item: self.order[item.nodeid]
        )

    def pytest_runtest_logstart(self, nodeid):
        os.utime(self.folder / forks.BEAT)
        (self.folder / NOTICED_BY).write_text(nodeid, "utf-8")

    def pytest_collectreport(self, report):
        if report.failed:
            (self.folder / NOTICED_BY).write_text(f"{report.nodeid} (import)", "utf-8")


def survives(trial: Trial, folder: Path) -> int:
    """Runs a trial in this process, which must not have imported the faulty module; 0 where no test failed."""
    told = json.dumps([str(Path(trial.fault.path).resolve()), trial.fault.place, trial.fault.choice])
    inherited = [path for path in [os.environ.get("PYTHONPATH")] if path]
    os.environ |= {"ROADPERC_FAULT": told, "PYTHONPATH": os.pathsep.join([str(HOOK), *inherited])}
    _hook().install(told)
    hypothesis.settings.register_profile("mutants", derandomize=True, database=None)
    hypothesis.settings.load_profile("mutants")
    code = int(pytest.ExitCode.NO_TESTS_COLLECTED)
    for tests in in_parts(trial.tests):
        files = list(dict.fromkeys(test.file for test in tests))
        code = int(pytest.main([*files, "-x", *quietly(folder)], plugins=[Chosen(tests, folder)]))
        if code not in UNNOTICED:
            break
    return code


def _hook():
    spec = importlib.util.spec_from_file_location("_fault_hook", HOOK / "sitecustomize.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
