"""Runs fuzz cases and prints the faults that they find."""

import argparse
import ctypes
import json
import os
import signal
import sys
import time
from collections import Counter, defaultdict

from tests.fuzz.cases import Case, named, recorded
from tests.fuzz.judge import kind_of_message
from tests.fuzz.trying import Verdict, import_commands, run

SHOWN_CASES = 5
M_ARENA_MAX = -8
"""From glibc's malloc.h. Each arena takes 64 MB of address space, which is limited."""
DESCRIPTION = """Makes logs, tables, configurations, lane files and dumps with one to three faults each, and runs a
command on each. The command must end with a result or one clear line, within 10 seconds and a gigabyte. It must leave
no partial file, print no control characters, and give the same bytes again. Exit code 1 if a command breaks a rule.
The cases of the corpus run first."""
EPILOG = """A case SEED:NUMBER follows from its name. A failed case is printed with its recipe and the command that
repeats it; --case also takes a file with a recipe."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.fuzz", description=DESCRIPTION, epilog=EPILOG)
    made.add_argument("--count", type=int, default=2000, metavar="N", help="number of cases (default: 2000)")
    made.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the random cases (default: 1)")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes (default: the cores)")
    made.add_argument(
        "--case", action="append", metavar="CASE", help="SEED:NUMBER, a name in the corpus, or a recipe's file"
    )
    return made


def main(arguments: list[str] | None = None) -> int:
    """Run the cases; returns 0 if no fault was found."""
    asked = parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the finally clause ends all processes
    ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    import_commands()
    started = time.monotonic()
    codes: dict[str, Counter[int | None]] = defaultdict(Counter)
    faults: dict[str, list[str]] = defaultdict(list)
    try:
        for case, verdict in run(cases(asked), max(asked.jobs, 1)):
            report(case, verdict, quiet=not asked.case)
            codes[verdict.command][verdict.code] += 1
            for fault in verdict.faults:
                faults[f"{verdict.command}: {kind_of_message(fault)}"].append(case.name)
    except KeyboardInterrupt:
        print("interrupted")
    count, results = sum(map(Counter.total, codes.values())), sum(found[0] for found in codes.values())
    print(f"{count} cases in {time.monotonic() - started:.0f} s, {results} with a result")
    for command, found in sorted(codes.items()):
        print(f"  {command}: {', '.join(f'exit code {code}: {n}' for code, n in sorted(found.items(), key=str))}")
    for kind, names in sorted(faults.items(), key=lambda item: -len(item[1])):
        print(f"FAULT: {len(names)} {kind}   ({' '.join(names[:SHOWN_CASES])})")
    return 1 if faults else 0


def report(case: Case, verdict: Verdict, *, quiet: bool) -> None:
    """Print a case with a fault and how to repeat it; if not quiet, also cases without faults."""
    if verdict.faults or not quiet:
        print(f"{case.name}: {verdict.line}: {verdict.code} {verdict.message}", flush=True)
    for fault in verdict.faults:
        print(f"  {fault}\n  again: python -m tests.fuzz --case {case.name}")
        print(f"  recipe: {json.dumps(verdict.recipe)}", flush=True)


def cases(asked: argparse.Namespace) -> list[Case]:
    """The cases named by the arguments, or the corpus and random cases."""
    if asked.case:
        return [named(name) for name in asked.case]
    return [*recorded().values(), *(Case(f"{asked.seed}:{k}") for k in range(asked.count))]


if __name__ == "__main__":
    sys.exit(main())
