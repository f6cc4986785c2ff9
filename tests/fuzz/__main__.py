"""Gives every command inputs that are wrong in some place, and counts what comes of it."""

import argparse
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
from tests.fuzz.known import is_known
from tests.fuzz.pool import Order, run
from tests.fuzz.trying import Verdict

EVERY_WHOLE = 50
SHOWN_MESSAGES = 25
SHOWN_CASES = 5
UNREADABLE = ("damaged MCAP", "cut off", "not an MCAP log", "its data cannot be read", "not TOML", "Invalid JSON")
"""What is said of an input that is refused as a whole: its magic, checksums or syntax are wrong."""
DESCRIPTION = """Makes logs, tables, configurations, true lanes and folders of frames that are wrong in one to three
places, and runs a command on each: it must end with a result or one clear line, within 10 seconds and a gigabyte, leave
no file half written, print no control characters, and give the same bytes again. Exit code 1 where one does not."""
EPILOG = """Case SEED:NUMBER follows from its name alone. What fails is printed with the line that repeats it and its
recipe, which --case takes from a file as well. Every 50th case runs as a process of its own, and the logs it writes are
read by a second reader where there is one."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.fuzz", description=DESCRIPTION, epilog=EPILOG)
    made.add_argument("--count", type=int, default=2000, metavar="N", help="how many cases (default: 2000)")
    made.add_argument("--first", type=int, default=0, metavar="N", help="number of the first one (default: 0)")
    made.add_argument("--seed", type=int, default=1, metavar="N", help="what is drawn follows from it (default: 1)")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N", help="processes (default: the cores)")
    made.add_argument(
        "--case", action="append", metavar="CASE", help="SEED:NUMBER, a name in the corpus, or a recipe's file"
    )
    only = made.add_mutually_exclusive_group()
    only.add_argument("--corpus", action="store_true", help="the corpus alone")
    only.add_argument("--drawn", action="store_true", help="drawn cases alone")
    whole = made.add_mutually_exclusive_group()
    whole.add_argument("--whole", action="store_true", help="every case as a process of its own")
    whole.add_argument("--quick", action="store_true", help="none as a process of its own")
    made.add_argument("--verbose", action="store_true", help="print every case")
    return made


@dataclass
class Tally:
    """What came of the cases."""

    cases: int = 0
    codes: Counter[str] = field(default_factory=Counter)
    results: int = 0
    unreadable: int = 0
    messages: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    faults: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    known: Counter[str] = field(default_factory=Counter)
    most_grown_bytes: int = 0
    longest_s: float = 0.0

    def add(self, case: str, verdict: Verdict) -> None:
        """Count a case."""
        self.cases += 1
        self.codes[f"{verdict.command} {verdict.codes[0]}"] += 1
        self.results += verdict.codes[0] == 0
        if verdict.codes[0]:
            self.messages[verdict.message].append(case)
            self.unreadable += any(words in verdict.message for words in UNREADABLE)
        for fault in verdict.faults:
            if is_known(case, fault):
                self.known[same_kind(fault)] += 1
            else:
                self.faults[f"{verdict.command}: {same_kind(fault)}"].append(case)
        self.most_grown_bytes = max(self.most_grown_bytes, verdict.grown_bytes)
        self.longest_s = max(self.longest_s, verdict.seconds)

    def lines(self, seconds: float) -> Iterable[str]:
        """For a person."""
        yield f"{self.cases} cases in {seconds:.0f} s"
        within = self.cases - self.results - self.unreadable
        yield f"results {self.results}, refused as a whole {self.unreadable}, refused within {within}"
        by_command: dict[str, list[str]] = defaultdict(list)
        for key, number in sorted(self.codes.items()):
            command, _, code = key.rpartition(" ")
            by_command[command].append(f"{code}: {number}")
        yield "exit codes: " + "; ".join(f"{command} {', '.join(codes)}" for command, codes in by_command.items())
        yield f"longest case {self.longest_s:.1f} s, most memory {self.most_grown_bytes / 2**20:.0f} MB"
        yield f"{len(self.messages)} different messages, the most frequent:"
        frequent = sorted(self.messages.items(), key=lambda item: -len(item[1]))[:SHOWN_MESSAGES]
        yield from (f"  {len(found):5} {text}   ({found[0]})" for text, found in frequent)
        for kind, number in self.known.most_common():
            yield f"known: {number} {kind}"
        for kind, found in sorted(self.faults.items(), key=lambda item: -len(item[1])):
            yield f"FAULT: {len(found)} {kind}   ({' '.join(found[:SHOWN_CASES])})"


def main(arguments: list[str]) -> int:
    """Runs the command; 0 where every case kept the promise."""
    asked = parser().parse_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that no process is left behind
    started, tally = time.monotonic(), Tally()
    try:
        for order, verdict in run(orders(asked), max(asked.jobs, 1)):
            report(order, verdict, quiet=not (asked.verbose or asked.case))
            tally.add(order.case, verdict)
    except KeyboardInterrupt:
        print("interrupted")
    print("\n".join(tally.lines(time.monotonic() - started)))
    return 1 if tally.faults else 0


def report(order: Order, verdict: Verdict, *, quiet: bool) -> None:
    """Print a case that has a fault, and how to repeat it; others only where they are asked for."""
    new = [fault for fault in verdict.faults if not is_known(order.case, fault)]
    if new or not quiet:
        print(f"{order.case}: {verdict.line}: {verdict.codes} {verdict.message}", flush=True)
    for fault in new:
        print(f"  {fault}\n  again: python -m tests.fuzz --case {order.case}{' --whole' * order.whole}")
        print(f"  recipe: {json.dumps(verdict.recipe)}", flush=True)


def orders(asked: argparse.Namespace) -> list[Order]:
    """The cases that the arguments ask for."""
    if asked.case:
        return [Order(named(name).name, asked.whole) for name in asked.case]
    corpus = [] if asked.drawn else [Order(name, asked.whole) for name in recorded()]
    numbers = range(asked.first, asked.first + asked.count) if not asked.corpus else ()
    return corpus + [Order(drawn(asked.seed, k).name, asked.whole or _is_whole(asked, k)) for k in numbers]


def _is_whole(asked: argparse.Namespace, number: int) -> bool:
    """Whether a case shows what starting a process shows: twenty times as slow as one in a worker."""
    return not asked.quick and number % EVERY_WHOLE == EVERY_WHOLE - 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
