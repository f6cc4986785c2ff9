"""Gives every command inputs that are wrong in some place, and counts what comes of it."""

import argparse
import ctypes
import json
import os
import signal
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field

from tests.fuzz.cases import drawn, named, recorded
from tests.fuzz.judge import same_kind
from tests.fuzz.trying import Order, Verdict, import_commands, run

EVERY_WHOLE = 50
SHOWN_MESSAGES = 25
SHOWN_CASES = 5
UNREADABLE = ("damaged MCAP", "cut off", "not an MCAP log", "its data cannot be read", "not TOML", "Invalid JSON")
"""What is said of an input that is refused as a whole: its magic, checksums or syntax are wrong."""
M_ARENA_MAX = -8
"""Of glibc's malloc.h. Each arena takes 64 MB of address space, which is what is limited."""
DESCRIPTION = """Makes logs, tables, configurations, true lanes and folders of frames that are wrong in one to three
places, and runs a command on each: it must end with a result or one clear line, within 10 seconds and a gigabyte, leave
no file half written, print no control characters, and give the same bytes again. Exit code 1 where one does not. The
cases of the corpus come first."""
EPILOG = """Case SEED:NUMBER follows from its name alone. What fails is printed with the line that repeats it and its
recipe, which --case takes from a file as well. Every 50th case runs as a process of its own, and the logs it writes are
read by a second reader where there is one."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.fuzz", description=DESCRIPTION, epilog=EPILOG)
    made.add_argument("--count", type=int, default=2000, metavar="N", help="how many cases (default: 2000)")
    made.add_argument("--seed", type=int, default=1, metavar="N", help="what is drawn follows from it (default: 1)")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes (default: the cores)")
    made.add_argument(
        "--case", action="append", metavar="CASE", help="SEED:NUMBER, a name in the corpus, or a recipe's file"
    )
    made.add_argument("--whole", action="store_true", help="every case as a process of its own")
    return made


@dataclass
class Tally:
    """What came of the cases."""

    cases: int = 0
    codes: dict[str, Counter[int | None]] = field(default_factory=lambda: defaultdict(Counter))
    unreadable: int = 0
    messages: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    faults: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    longest_s: float = 0.0

    def add(self, case: str, verdict: Verdict) -> None:
        """Count a case."""
        self.cases += 1
        self.codes[verdict.command][verdict.code] += 1
        if verdict.code:
            self.messages[verdict.message].append(case)
            self.unreadable += any(words in verdict.message for words in UNREADABLE)
        for fault in verdict.faults:
            self.faults[f"{verdict.command}: {same_kind(fault)}"].append(case)
        self.longest_s = max(self.longest_s, verdict.seconds)

    def lines(self, seconds: float) -> Iterable[str]:
        """For a person."""
        results = sum(codes[0] for codes in self.codes.values())
        within = self.cases - results - self.unreadable
        yield f"{self.cases} cases in {seconds:.0f} s, the longest {self.longest_s:.1f} s"
        yield f"results {results}, refused as a whole {self.unreadable}, refused within {within}"
        by_command = (
            f"{name} {', '.join(f'{code}: {count}' for code, count in sorted(codes.items(), key=str))}"
            for name, codes in sorted(self.codes.items())
        )
        yield f"exit codes: {'; '.join(by_command)}"
        yield f"{len(self.messages)} different messages, the most frequent:"
        frequent = sorted(self.messages.items(), key=lambda item: -len(item[1]))[:SHOWN_MESSAGES]
        yield from (f"  {len(found):5} {text}   ({found[0]})" for text, found in frequent)
        for kind, found in sorted(self.faults.items(), key=lambda item: -len(item[1])):
            yield f"FAULT: {len(found)} {kind}   ({' '.join(found[:SHOWN_CASES])})"


def main(arguments: list[str]) -> int:
    """Runs the command; 0 where every case kept the promise."""
    asked = parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that no process is left behind
    ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
    import_commands()
    started, tally = time.monotonic(), Tally()
    try:
        for order, verdict in run(orders(asked), max(asked.jobs, 1)):
            report(order, verdict, quiet=not asked.case)
            tally.add(order.case.name, verdict)
    except KeyboardInterrupt:
        print("interrupted")
    print("\n".join(tally.lines(time.monotonic() - started)))
    return 1 if tally.faults else 0


def report(order: Order, verdict: Verdict, *, quiet: bool) -> None:
    """Print a case that has a fault, and how to repeat it; others only where they are asked for."""
    name = order.case.name
    if verdict.faults or not quiet:
        print(f"{name}: {verdict.line}: {verdict.code} {verdict.message}", flush=True)
    for fault in verdict.faults:
        print(f"  {fault}\n  again: python -m tests.fuzz --case {name}{' --whole' * order.whole}")
        print(f"  recipe: {json.dumps(verdict.recipe)}", flush=True)


def orders(asked: argparse.Namespace) -> list[Order]:
    """The cases that the arguments ask for."""
    if asked.case:
        return [Order(named(name), asked.whole) for name in asked.case]
    cases = [*recorded().values(), *(drawn(asked.seed, k) for k in range(asked.count))]
    return [Order(case, asked.whole or k % EVERY_WHOLE == EVERY_WHOLE - 1) for k, case in enumerate(cases)]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
