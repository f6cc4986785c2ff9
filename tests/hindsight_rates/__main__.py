"""Measures how far errors by hindsight can be believed: against truth, and as the only errors that compare sees.

Drives are rendered with noise and replayed. The random numbers are fixed. The page's table is replaced with ``--page``.
"""

import argparse
import re
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from tests.hindsight_rates.drives import KINDS, drives, tables_of
from tests.hindsight_rates.trials import CHANGES, FEWEST_OF_FOUND, MOST_ALARMS, verdict_rates
from tests.hindsight_rates.truth import table

BLOCK = re.compile(r"(<!-- hindsight rates -->\n).*?(<!-- end -->)", re.DOTALL)


def main():
    """Run the command; return the exit code: 1 if compare is wrong more often than allowed."""
    parser = argparse.ArgumentParser("python -m tests.hindsight_rates", description=__doc__)
    parser.add_argument("folder", type=Path, help="for logs and tables, which are kept")
    parser.add_argument("--first-seed", type=int, default=830)
    parser.add_argument("--seeds", type=int, default=2, help="drives of each kind and scene")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--only", default="", help="kinds whose name contains this text")
    parser.add_argument("--no-verdicts", action="store_true", help="leave out the trials of compare")
    parser.add_argument("--page", type=Path, help="page whose table is replaced")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    kinds = [kind for kind in KINDS if arguments.only in kind]
    with ProcessPoolExecutor(arguments.jobs, get_context("spawn")) as pool:
        every = [drive for kind in kinds for drive in drives(kind, seeds)]
        folders = list(pool.map(partial(tables_of, arguments.folder), every))
        text = table({kind: [at for d, at in zip(every, folders, strict=True) if d.kind == kind] for kind in kinds})
        found, of_truth, alarms, pairs = (0, 0, 0, 0)
        if not arguments.no_verdicts:
            found, of_truth, alarms, pairs = verdict_rates(arguments.folder, pool)
            text += (
                f"\nOf {len(CHANGES)} changes of settings, compare finds {of_truth} worse with truth, and {found} of "
                f"these by hindsight alone. Of {pairs} pairs that differ in `seed` only, {alarms} alarm.\n"
            )
    print(text)
    if arguments.page:
        page = arguments.page.read_text(encoding="utf-8")
        arguments.page.write_text(BLOCK.sub(lambda block: f"{block[1]}{text}{block[2]}", page), encoding="utf-8")
    return 0 if alarms <= MOST_ALARMS and found >= FEWEST_OF_FOUND * of_truth else 1


if __name__ == "__main__":
    raise SystemExit(main())
