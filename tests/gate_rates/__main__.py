"""Measures how often compare is wrong: alarms between runs that differ in the seed only, injected regressions found.

Rendered logs with 2 % tag and 1 % depth noise are replayed with several seeds. The random numbers are fixed.
"""

import argparse
import re
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from tests.gate_rates.injections import INJECTIONS
from tests.gate_rates.trials import SCENES, alarms, render, replayed, trials

SEEDS = 21
MOST_ALARMS = 4
FEWEST_FOUND = 38
BLOCK = re.compile(r"(<!-- gate rates -->\n).*?(<!-- end -->)", re.DOTALL)


def table(rates):
    """A Markdown table of the trials with an alarm, from name, alarms and number of trials."""
    lines = ["| new run | trials | required | alarms |", "|---|---|---|---|"]
    for name, found, count in rates:
        required = f"at least {FEWEST_FOUND}" if name else f"at most {MOST_ALARMS}"
        lines.append(f"| {name or 'differs in `seed` only'} | {count} | {required} | {found} |")
    return "".join(f"{line}\n" for line in lines)


def measure(arguments):
    """Render, replay, compare; print each unexpected result and the table; return whether all rates are as required."""
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(arguments.jobs, get_context("spawn")) as pool:
        logs = list(pool.map(partial(render, folder), range(len(SCENES))))
        runs = list(pool.map(partial(replayed, folder, logs), range(arguments.seeds)))
        every = trials(runs)
        results = list(pool.map(alarms, every, chunksize=4))
    rates = []
    for name in ("", *INJECTIONS):
        found = [(trial, worse) for trial, worse in zip(every, results, strict=True) if trial.name == name]
        rates.append((name, sum(bool(worse) for _, worse in found), len(found)))
        for trial, worse in found:
            if bool(worse) != bool(name):
                print(f"{trial.base} {trial.new} {trial.seed}: {name} worse in {worse}")
    text = table(rates)
    print(text)
    if arguments.page:
        page = arguments.page.read_text(encoding="utf-8")
        arguments.page.write_text(BLOCK.sub(lambda block: f"{block[1]}{text}{block[2]}", page), encoding="utf-8")
    return rates[0][1] <= MOST_ALARMS and all(found >= FEWEST_FOUND for _, found, _ in rates[1:])


def main():
    """Run the command; return the exit code: 1 if a rate is not as required."""
    parser = argparse.ArgumentParser("python -m tests.gate_rates", description=__doc__)
    parser.add_argument("folder", type=Path, help="for logs and tables, which are kept")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--page", type=Path, help="page whose table is replaced")
    return 0 if measure(parser.parse_args()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
