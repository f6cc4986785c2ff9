"""A process that tries one case after the other: names come in, verdicts go out, a line of JSON each."""

import json
import os
import signal
import sys
from dataclasses import asdict
from typing import IO

from tests.fuzz import bounds, cases, contents, dumps
from tests.fuzz.choices import Choices
from tests.fuzz.judge import FUZZER, crash_line, crash_of
from tests.fuzz.trying import tried, warm_up, without_answer


def main() -> None:
    """Serve until no more names come."""
    orders, answers = _own_streams()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    plain = Choices({"kind": "plain"})
    warm_up(
        contents.encoded(contents.drive(contents.RESULT_FRAMES), "zstd"), lambda folder: dumps.write_dump(folder, plain)
    )
    for make in contents.BASES.values():
        make()
    whole_limit_bytes = bounds.memory()["VmSize"] + bounds.MOST_GROWTH_BYTES
    _say(answers, ready=True)
    for line in orders:
        order = json.loads(line)
        bounds.limit_growth()
        limit = whole_limit_bytes if order["whole"] else None
        try:
            verdict = tried(cases.named(order["case"]), lambda: _say(answers, beat=True), limit)
        except Exception as error:  # a fault of the fuzzer itself: it is reported as one, and the next case follows
            verdict = without_answer("fuzzer", f"its own fault: {crash_line(crash_of(error), FUZZER)}")
        bounds.lift_limit()
        _say(answers, verdict=asdict(verdict))


def _own_streams() -> tuple[IO[str], IO[str]]:
    """Where orders come from and answers go to; what a command reads or prints does not."""
    orders, answers = os.fdopen(os.dup(0), "r"), os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1):
        os.dup2(nothing, number)
    sys.stdin = os.fdopen(0, "r", closefd=False)
    return orders, answers


def _say(answers: IO[str], **what: object) -> None:
    answers.write(json.dumps(what) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
