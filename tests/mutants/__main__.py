"""Mutation testing: adds small faults to the code with cosmic-ray and counts how many the tests notice."""

import argparse
import ast
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import coverage
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

SOURCES = ("roadperc_stream", "tools", "eval")
KEPT = Path(".mutants")
HOOK = Path(__file__).parent / "hook"
WANTED_SHARE = 0.85
BUDGET_S = 60.0  # of tests for one fault
PATIENCE_S = 60.0
PATIENCE_FACTOR = 8.0  # the machine may be busy
LEFT_OUT = {Path("tests/test_docs.py"), *Path("tests/fuzz").glob("test_*.py")}  # they run much code and take too long
COMPARISONS = "Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Eq_NotEq NotEq_Eq Is_IsNot IsNot_Is"
ARITHMETIC = "Add_Sub Sub_Add Mul_Div Div_Mul FloorDiv_Mul Mod_Mul Pow_Mul BitAnd_BitOr BitOr_BitAnd LShift_RShift"
OTHERS = "AddNot NumberReplacer ReplaceTrueWithFalse ReplaceFalseWithTrue ReplaceAndWithOr ReplaceOrWithAnd"
OPERATORS = (
    *(f"core/ReplaceComparisonOperator_{change}" for change in COMPARISONS.split()),
    *(f"core/ReplaceBinaryOperator_{change}" for change in ARITHMETIC.split()),
    *(f"core/{name}" for name in OTHERS.split()),
    *(f"core/{name}" for name in ("ReplaceUnaryOperator_USub_UAdd", "ReplaceUnaryOperator_Delete_Not")),
    *(f"core/{name}" for name in ("ReplaceBreakWithContinue", "ReplaceContinueWithBreak")),
)
"""The operators of cosmic-ray with small faults; the others mostly cause a TypeError, which any test notices."""
MEASURING = """[run]
source = {sources}
data_file = {folder}/coverage
parallel = true
patch = subprocess, _exit, fork
concurrency = thread,multiprocessing
disable_warnings = no-data-collected, module-not-measured, module-not-imported, already-imported, no-ctracer
"""
DESCRIPTION = """Draws small faults from all code and runs the nearest test files with each fault. Prints every fault
that no test notices, and the noticed share. The working tree does not change: an import hook adds the fault. Exit code
0 if at least 85 of 100 faults are noticed, else 1."""
EPILOG = """The first run measures which test files execute which lines (about 12 minutes on two cores) and keeps the
result in .mutants/. Later runs measure only changed test files and those that execute changed code. A test that also
fails without the fault does not count. A fault that makes a test hang counts as noticed."""


@dataclass(frozen=True)
class Fault:
    """A small fault: one operator of cosmic-ray at one of its places in a file."""

    path: str
    operator: str
    occurrence: int
    first_line: int
    """The first line of its statement."""
    line: int

    def source(self) -> str:
        """The source of the file with the fault."""
        return mutate_code(Path(self.path).read_text("utf-8"), get_operator(self.operator)(), self.occurrence)

    def __str__(self) -> str:
        before, after = Path(self.path).read_text("utf-8").splitlines(), self.source().splitlines()
        changed = [k for k, pair in enumerate(zip(before, after, strict=True)) if pair[0] != pair[1]]
        return f"{self.path}:{self.line} {before[changed[0]].strip()} -> {after[changed[0]].strip()}"


@dataclass(frozen=True)
class Reach:
    """A test file, its duration, and the lines of each source file that it executes."""

    test_file: str
    seconds: float
    lines: dict[str, list[int]]

    def is_near(self, path: str) -> bool:
        """True if the test file is named after a module or its package, or compares it with a recording."""
        name = Path(self.test_file).stem.removeprefix("test_")
        if name == "recorded":
            return Path(self.test_file).parent.name in {"tests", "cli", *Path(path).parts}  # those two run all packages
        return name in {Path(path).stem, Path(path).parent.name}


def main(arguments: list[str]) -> int:
    """Run the command; returns 0 if enough faults are noticed."""
    parser = argparse.ArgumentParser("python -m tests.mutants", description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument("only", nargs="*", help="files or folders to draw from (default: all code)")
    parser.add_argument("--count", type=int, default=200, metavar="N", help="number of faults (default: 200)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the random faults (default: 1)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes (default: the cores)")
    asked = parser.parse_args(arguments)
    drawn = draw(asked.only, asked.count, asked.seed)
    if not drawn:
        print("no faults to try")
        return 0
    started, survivors = time.monotonic(), 0
    test_files = sorted(map(str, {*Path("tests").rglob("test_*.py")} - LEFT_OUT))
    with ThreadPoolExecutor(asked.jobs) as pool:
        reaches = list(pool.map(measured, test_files))
        near = [nearest(fault, reaches) for fault in drawn]
        try:
            for fault, tests, noticed in zip(drawn, near, pool.map(notices, drawn, near), strict=True):
                if not noticed:
                    survivors += 1
                    print(f"{fault}   ({len(tests)} test files)", flush=True)
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
            raise
    noticed = len(drawn) - survivors
    print(f"noticed {noticed} of {len(drawn)} ({noticed / len(drawn):.1%}) in {time.monotonic() - started:.0f} s")
    return 0 if noticed >= WANTED_SHARE * len(drawn) else 1


def draw(only: list[str], count: int, seed: int) -> list[Fault]:
    """At most `count` faults at different places, from all code or from the files and folders `only`."""
    files = sorted(path for folder in SOURCES for path in Path(folder).rglob("*.py") if "_pb2" not in path.name)
    files = [file for file in files if not only or any(file.is_relative_to(path) for path in only)]
    chosen, drawn = random.Random(seed), {}
    sizes = [len(file.read_text("utf-8").splitlines()) for file in files]
    for file in chosen.choices(files, sizes, k=10 * count) if sum(sizes) else ():
        if places := places_in(str(file)):
            place = chosen.choice(sorted(places))
            drawn.setdefault((file, place), chosen.choice(places[place]))
        if len(drawn) == count:
            break
    return list(drawn.values())


@cache
def places_in(path: str) -> dict[tuple, list[Fault]]:
    """The possible faults at each place of a file."""
    source, found = Path(path).read_text("utf-8"), defaultdict(list)
    tree = ast.parse(source)
    left_out = [_span(node) for node in _left_out(tree)]
    nodes = list(ast_nodes(get_ast(source)))
    statements = [node for node in ast.walk(tree) if isinstance(node, ast.stmt)]
    for name in OPERATORS:
        operator = get_operator(name)()
        places = (place for node in nodes for place in operator.mutation_positions(node))
        for occurrence, (start, end) in enumerate(places):
            if not any(first <= start and end <= last for first, last in left_out):
                around = [node.lineno for node in statements if _span(node)[0] <= start and end <= _span(node)[1]]
                found[start, end].append(Fault(path, name, occurrence, max(around, default=start[0]), start[0]))
    return found


def _span(node: ast.AST) -> tuple[tuple[int, int], tuple[int, int]]:
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)


def _left_out(tree: ast.Module) -> Iterator[ast.AST]:
    """Code without effect on results: types, decorators, error messages, assertions, ``repr``, keyword-only marks."""
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg == "repr":
            yield node
        if isinstance(node, ast.arguments) and node.kwonlyargs and node.vararg is None:
            before = [_span(argument)[1] for argument in (*node.args, *node.defaults)]
            line, column = max(before, default=(node.kwonlyargs[0].lineno, 0))
            first = node.kwonlyargs[0]
            yield ast.Pass(lineno=line, col_offset=column, end_lineno=first.lineno, end_col_offset=first.col_offset)
        if isinstance(node, ast.Raise | ast.Assert):
            yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) in {"TYPE_CHECKING", "__name__ == '__main__'"}:
            yield node
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.BinOp) and isinstance(node.value.op, ast.BitOr):
            yield node
        if isinstance(node, ast.Subscript) and ast.unparse(node.value).endswith("Literal"):
            yield node
        yield from getattr(node, "decorator_list", ())
        yield from filter(None, (getattr(node, "annotation", None), getattr(node, "returns", None)))


def measured(test_file: str) -> Reach:
    """The lines that a test file executes: kept from an earlier run if the code is unchanged, else measured."""
    kept = KEPT / f"{test_file.replace('/', '.')}.json"
    if kept.is_file():
        known = Reach(**json.loads(kept.read_text("utf-8")))
        changed = (Path(path) for path in (test_file, *known.lines))
        if all(path.is_file() and path.stat().st_mtime < kept.stat().st_mtime for path in changed):
            return known
    lines, started = defaultdict(set), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
        settings = Path(folder, "coveragerc")
        settings.write_text(MEASURING.format(sources=",".join(map(os.path.abspath, SOURCES)), folder=folder), "utf-8")
        run_tests([test_file], folder, 900.0, ("coverage", "run", f"--rcfile={settings}", "-m"))
        for file in Path(folder).glob("coverage.*"):
            data = coverage.CoverageData(str(file))
            try:
                data.read()
            except coverage.exceptions.DataError:  # of a process that a test killed
                continue
            for path in data.measured_files():
                lines[os.path.relpath(path)].update(data.lines(path))
    found = Reach(test_file, time.monotonic() - started, {path: sorted(numbers) for path, numbers in lines.items()})
    KEPT.mkdir(exist_ok=True)
    kept.write_text(json.dumps(asdict(found)), "utf-8")
    return found


def nearest(fault: Fault, reaches: list[Reach]) -> list[Reach]:
    """The test files that execute a fault, nearest and quickest first, within the time budget; at least one."""
    there = [(reach, set(reach.lines.get(fault.path, ()))) for reach in reaches]
    found = [reach for reach, lines in there if lines.intersection(range(fault.first_line, fault.line + 1))]
    found = found or [reach for reach, lines in there if lines]
    chosen, spent = [], 0.0
    for reach in sorted(found, key=lambda reach: (not reach.is_near(fault.path), reach.seconds)):
        if not chosen or spent + reach.seconds <= BUDGET_S:
            chosen.append(reach)
            spent += reach.seconds
    return chosen


def notices(fault: Fault, reaches: list[Reach]) -> bool:
    """True if one of the test files fails or hangs because of a fault."""
    patience_s = PATIENCE_S + PATIENCE_FACTOR * sum(reach.seconds for reach in reaches)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        faulty = Path(folder, "faulty.py")
        faulty.write_text(fault.source(), "utf-8")
        variables = {"ROADPERC_FAULT": json.dumps([os.path.realpath(fault.path), str(faulty)]), "PYTHONPATH": str(HOOK)}
        arguments = [reach.test_file for reach in reaches]
        while reaches:
            code, printed = run_tests(["-x", *arguments], folder, patience_s, **variables)
            failed = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", printed, re.MULTILINE)
            if code in (0, 5):
                return False
            if failed is None or passes(failed[1]):
                return True
            arguments += ["--deselect", failed[1]]
    return False


@cache
def passes(test: str) -> bool:
    """True if a test passes without a fault."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        return run_tests([test], folder, 900.0)[0] == 0


def run_tests(
    arguments: list[str], folder: str, patience_s: float, program: tuple[str, ...] = (), **variables: str
) -> tuple[int, str]:
    """Run pytest; returns its exit code and output. It writes only to `folder`."""
    words = [sys.executable, "-m", *program, "pytest", *arguments, "-rfE", "--tb=no", "-p", "no:cacheprovider"]
    paths = [variables.get("PYTHONPATH"), os.environ.get("PYTHONPATH")]
    variables |= {
        "CI": "true",
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
    }  # hypothesis is repeatable
    with subprocess.Popen(
        [*words, f"--basetemp={folder}/pytest"], env=os.environ | variables, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
    ) as process:  # fmt: skip
        try:
            printed, _ = process.communicate(timeout=patience_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return -signal.SIGKILL, ""
    return process.returncode, printed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
