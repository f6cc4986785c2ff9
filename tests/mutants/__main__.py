"""Puts small faults into the code and counts how many of them the tests notice."""

import argparse
import json
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest

from tests.mutants import forks, reach
from tests.mutants.faults import Fault, faults_in
from tests.mutants.reach import Reach
from tests.mutants.trial import NOTICED_BY, UNNOTICED, Trial, planned, survives

SOURCES = ("roadperc_stream", "tools", "eval")
GENERATED = "_pb2.py"
KEPT = Path(".mutants")
WANTED_SHARE = 0.85
FAILED = {pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.INTERRUPTED}  # the latter where a test cannot be imported
MEASURING_PATIENCE_S = 900.0
LEFT_OUT = {Path("tests/test_docs.py"), Path("tests/fuzz/test_fuzz.py")}  # what reaches far in them takes too long

DESCRIPTION = """Draws small faults from all code (a comparison, a sign, an arithmetic operator, a constant, and/or,
a dropped not, min/max), runs for each the tests nearest to it with the fault in place, and prints the share that a
test notices and every fault that none does. Nothing in the working tree is touched: a fault is put in as its module is
imported. Exit code 0 where at least 85 of 100 are noticed, 1 where fewer are."""
EPILOG = """The first run measures which tests execute which lines (about 12 minutes on two cores) and keeps that in
.mutants/; later ones measure anew only the test files that changed or execute something that did. After that 200 faults
take about 15 minutes on two cores. A fault that makes a test hang counts as noticed."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.mutants", description=DESCRIPTION, epilog=EPILOG)
    made.add_argument("only", nargs="*", help="files or folders to draw from (default: all code)")
    made.add_argument("--count", type=int, default=200, metavar="N", help="how many faults (default: 200)")
    made.add_argument("--seed", type=int, default=1, metavar="N", help="what is drawn follows from it (default: 1)")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes (default: the cores)")
    made.add_argument("--seconds", type=float, default=45, help="of tests a fault may cost (default: 45)")
    made.add_argument("--again", action="store_true", help="only what survived the last run of this count and seed")
    made.add_argument("--verbose", action="store_true", help="also print each noticed fault and the test that did")
    return made


def main(arguments: list[str]) -> int:
    """Runs the command; 0 where enough of the faults were noticed."""
    asked = parser().parse_args(arguments)
    drawn = sample(all_faults(asked.only), asked.count, asked.seed)
    survivors_file = KEPT / f"survivors-{asked.count}-{asked.seed}.json"
    if asked.again:
        known = {tuple(fault.values()) for fault in json.loads(survivors_file.read_text("utf-8"))}
        drawn = [fault for fault in drawn if tuple(asdict(fault).values()) in known]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that no process is left behind
    if not drawn:
        print("no faults to try")
        return 0
    started = time.monotonic()
    forks.import_libraries()
    reaches = list(measured(sorted(map(str, {*Path("tests").rglob("test_*.py")} - LEFT_OUT)), asked.jobs))
    survivors = list(tried([planned(fault, reaches, asked.seconds) for fault in drawn], asked.jobs, asked.verbose))
    survivors_file.write_text(json.dumps([asdict(fault) for fault in sorted(survivors)], indent=1), "utf-8")
    share = 1 - len(survivors) / len(drawn)
    print(f"noticed {len(drawn) - len(survivors)} of {len(drawn)} ({share:.1%}) in {time.monotonic() - started:.0f} s")
    return 0 if share >= WANTED_SHARE else 1


def all_faults(only: list[str]) -> list[tuple[Fault, ...]]:
    """The faults of all code, or of what lies at or below one of the paths `only`."""
    files = sorted(path for folder in SOURCES for path in Path(folder).rglob("*.py") if GENERATED not in path.name)
    wanted = [file for file in files if not only or any(file.is_relative_to(path) for path in only)]
    return [alternatives for file in wanted for alternatives in faults_in(str(file), file.read_text("utf-8"))]


def sample(places: list[tuple[Fault, ...]], count: int, seed: int) -> list[Fault]:
    """At most `count` faults, each at another place; of the faults a place can have any is as likely."""
    random_numbers = random.Random(seed)
    return [random_numbers.choice(found) for found in random_numbers.sample(places, min(count, len(places)))]


def measured(test_files: list[str], jobs: int) -> Iterator[Reach]:
    """The reach of each test file: as kept where that is fresh, else measured and kept."""
    stale = []
    for file in test_files:
        kept = KEPT / f"{file.replace('/', '.')}.json"
        known = reach.load(kept) if kept.is_file() else None
        if known is not None and reach.is_fresh(known):
            yield known
        else:
            stale.append((file, kept))
    if stale:
        print(f"measuring what {len(stale)} test files execute", flush=True)
    for ended in forks.run(stale, _measure, lambda _: MEASURING_PATIENCE_S, jobs):
        file, kept = ended.job
        if ended.code or not kept.is_file():
            print(f"{file} could not be measured: {_last_lines(ended.folder)}", flush=True)
            continue
        found = reach.load(kept)
        yield found
        for test in found.tests:
            if not test.passed:
                print(f"left out, for it fails without any fault: {test.nodeid}", flush=True)


def _last_lines(folder: Path) -> str:
    return " | ".join((folder / forks.OUTPUT).read_text("utf-8").splitlines()[-3:])


def _measure(job: tuple[str, Path], folder: Path) -> int:
    file, kept = job
    reach.save(reach.measure(file, folder, list(SOURCES)), kept)
    return 0


def tried(trials: list[Trial], jobs: int, verbose: bool) -> Iterator[Fault]:
    """Tries each fault, prints what survives as it does, and yields it."""
    for ended in forks.run(trials, survives, lambda trial: trial.patience_s, jobs):
        fault = ended.job.fault
        if ended.code in UNNOTICED and not ended.hung:
            print(f"{fault}   ({len(ended.job.tests)} tests)", flush=True)
            yield fault
        elif ended.code not in FAILED and ended.code > 0:
            raise RuntimeError(f"{fault} could not be tried: {_last_lines(ended.folder)}")
        elif verbose:
            by = ended.folder / NOTICED_BY
            print(f"noticed: {fault} by {by.read_text('utf-8') if by.is_file() else ended.code}", flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
