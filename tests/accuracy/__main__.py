"""Measures the figures of docs/accuracy.md and prints them, required beside measured."""

import argparse
import os
import time
from pathlib import Path

from tests.accuracy.drives import ROOT
from tests.accuracy.figures import FIGURES
from tests.accuracy.printing import print_table, rows, with_figures
from tests.accuracy.running import remove_replays, run

SEEDS = 4
FIRST_SEED = 100


def parser():
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.accuracy", description=__doc__)
    made.add_argument("--seeds", type=int, default=SEEDS, help=f"of a usual drive; town has more (default: {SEEDS})")
    made.add_argument("--first-seed", type=int, default=FIRST_SEED, help="seeds to tune on are others (default: 100)")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: the cores)")
    made.add_argument("--folder", type=Path, default=ROOT / "logs" / "runs" / "accuracy", help="of rendered logs")
    made.add_argument("--page", type=Path, help="a page to write the tables into")
    made.add_argument("--only", action="append", metavar="SECTION", help="sections whose names begin so")
    return made


def main():
    """Render, replay, measure, print."""
    arguments = parser().parse_args()
    sections = tuple(arguments.only or ("",))
    figures = [figure for figure in FIGURES if figure.section.startswith(sections)]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    remove_replays(arguments.folder)
    started = time.monotonic()
    results = run(
        tuple(dict.fromkeys(scenario for figure in figures for scenario in figure.scenarios)),
        arguments.folder,
        first=arguments.first_seed,
        count=arguments.seeds,
        jobs=arguments.jobs,
        said=lambda text: print(text, flush=True),
    )
    lines = rows(figures, results)
    print_table(lines)
    print(f"{(time.monotonic() - started) / 60:.1f} minutes")
    if arguments.page:
        page = arguments.page.read_text(encoding="utf-8")
        arguments.page.write_text(with_figures(page, lines, about(results)), encoding="utf-8")


def about(results):
    """What was measured on, in a sentence."""
    seeds = sorted({replay.seed for replays in results.replays.values() for replay in replays})
    frames = sum(replay.frames.height for replays in results.replays.values() for replay in replays)
    return f"Seeds {seeds[0]} to {seeds[-1]}, {frames} frames replayed."


if __name__ == "__main__":
    main()
