"""Which tests execute which lines of the code: measured once per test file and kept in a folder git ignores."""

import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import coverage
import pytest

CONTEXT = "ROADPERC_CONTEXT"
OF_FIXTURE = "fixture "
SETTINGS = """[run]
source = {sources}
data_file = {folder}/coverage
parallel = true
concurrency = thread,multiprocessing
context = ${{ROADPERC_CONTEXT-}}
disable_warnings = no-data-collected, module-not-measured, module-not-imported, already-imported, no-ctracer
"""


@dataclass(frozen=True)
class TimedTest:
    """One test with the CPU seconds it took, the making of the fixtures it was the first to use included."""

    nodeid: str
    seconds: float
    passed: bool

    @property
    def file(self) -> str:
        return self.nodeid.partition("::")[0]


@dataclass(frozen=True)
class Reach:
    """What one test file executes: for each source file and line the indices of its tests; `digests` date it."""

    tests: tuple[TimedTest, ...]
    lines: dict[str, dict[int, tuple[int, ...]]]
    imported: tuple[str, ...]
    digests: dict[str, str]

    def on(self, path: str, first: int, last: int) -> set[TimedTest]:
        """The tests that execute one of the lines of a source file."""
        there = self.lines.get(path, {})
        return {self.tests[index] for line in range(first, last + 1) for index in there.get(line, ())}

    def anywhere_in(self, path: str) -> set[TimedTest]:
        """The tests that execute any line of a source file's functions; where none does, those that import it."""
        found = {self.tests[index] for indices in self.lines.get(path, {}).values() for index in indices}
        return found or (set(self.tests) if path in self.imported else set())


@dataclass(eq=False)  # pytest hashes its plugins
class Recorder:
    """A pytest plugin: names the running test to coverage and to the commands it starts, and takes its time."""

    measured: coverage.Coverage | None
    using: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    seconds: dict[str, float] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)
    now: str = ""

    def switch(self, context: str) -> None:
        self.now = os.environ[CONTEXT] = context
        if self.measured is not None:
            self.measured.switch_context(context)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        for name in item.fixturenames:
            self.using[OF_FIXTURE + name].add(item.nodeid)
        self.switch(item.nodeid)
        before = _cpu_seconds()
        try:
            return (yield)
        finally:
            self.seconds[item.nodeid] = _cpu_seconds() - before
            self.switch("")

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef):
        before = self.now
        if fixturedef.scope != "function":
            self.switch(OF_FIXTURE + fixturedef.argname)
        try:
            return (yield)
        finally:
            self.switch(before)

    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.failed.add(report.nodeid)


def _cpu_seconds() -> float:
    """Of this process and those it started: what a test costs, whatever else the machine does."""
    return sum(os.times()[:4])


def measure(test_file: str, folder: Path, sources: list[str]) -> Reach:
    """Runs one test file in this process, which must not have imported any of the sources, and measures its reach."""
    settings = folder / "coveragerc"
    settings.write_text(SETTINGS.format(sources=",".join(map(os.path.abspath, sources)), folder=folder), "utf-8")
    os.environ |= {"COVERAGE_PROCESS_START": str(settings), CONTEXT: ""}
    measured = coverage.Coverage(config_file=str(settings))
    recorder = Recorder(measured)
    measured.start()
    pytest.main([test_file, *quietly(folder)], plugins=[recorder])
    measured.stop()
    measured.save()
    del os.environ["COVERAGE_PROCESS_START"]
    if recorder.failed:  # under measurement, which some tests notice: only what fails without it as well is out
        again = Recorder(None)
        pytest.main([*sorted(recorder.failed), *quietly(folder)], plugins=[again])
        recorder.failed = again.failed
    return _gathered(test_file, recorder, folder)


def quietly(folder: Path) -> list[str]:
    """Arguments of pytest that leave nothing behind outside `folder`."""
    imported_before = "-Wignore::pytest.PytestAssertRewriteWarning"
    return ["-q", "-p", "no:cacheprovider", f"--basetemp={folder / 'pytest'}", "--tb=line", imported_before]


def _gathered(test_file: str, recorder: Recorder, folder: Path) -> Reach:
    tests = tuple(TimedTest(test, seconds, test not in recorder.failed) for test, seconds in recorder.seconds.items())
    index = {test.nodeid: number for number, test in enumerate(tests)}
    lines: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for path, line, contexts in _measured_lines(folder):
        nodeids = {nodeid for name in contexts for nodeid in recorder.using.get(name, {name})}
        lines[path][line] |= {index[nodeid] for nodeid in nodeids if nodeid in index}
    found = {path: {line: tuple(sorted(of)) for line, of in there.items() if of} for path, there in lines.items()}
    return Reach(tests, found, tuple(sorted(lines)), {path: digest(path) for path in (test_file, *lines)})


def _measured_lines(folder: Path) -> Iterator[tuple[str, int, list[str]]]:
    for file in sorted(folder.glob("coverage.*")):
        data = coverage.CoverageData(str(file))
        with suppress(coverage.exceptions.DataError):  # of a process that was killed
            data.read()
        for path in data.measured_files():
            for line, contexts in data.contexts_by_lineno(path).items():
                yield os.path.relpath(path), line, [name.split("|")[-1] for name in contexts]


def digest(path: str) -> str:
    """A name for what a file holds; empty where there is no such file."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16] if Path(path).is_file() else ""


def is_fresh(reach: Reach) -> bool:
    """Whether neither the test file nor anything it executes has changed since."""
    return all(digest(path) == before for path, before in reach.digests.items())


def save(reach: Reach, file: Path) -> None:
    """Writes a test file's reach; sets of tests that occur on many lines are written once."""
    sets = sorted({indices for there in reach.lines.values() for indices in there.values()})
    number = {indices: position for position, indices in enumerate(sets)}
    content = {
        "tests": [(test.nodeid, round(test.seconds, 4), test.passed) for test in reach.tests],
        "sets": sets,
        "lines": {path: {line: number[of] for line, of in there.items()} for path, there in reach.lines.items()},
        "imported": reach.imported,
        "digests": reach.digests,
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content), "utf-8")


def load(file: Path) -> Reach:
    """Reads what `save` wrote."""
    content = json.loads(file.read_text("utf-8"))
    sets = [tuple(indices) for indices in content["sets"]]
    return Reach(
        tests=tuple(TimedTest(*test) for test in content["tests"]),
        lines={path: {int(line): sets[of] for line, of in there.items()} for path, there in content["lines"].items()},
        imported=tuple(content["imported"]),
        digests=content["digests"],
    )
