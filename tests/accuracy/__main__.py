"""Measures the figures of docs/accuracy.md and prints them with the required values, or writes them into the page."""

import argparse
import os
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.accuracy.drives import ROOT
from tests.accuracy.figures import FIGURES
from tests.accuracy.page import HEADERS, by_section, cells, with_tables
from tests.accuracy.running import remove_replays, run

STYLES = {True: "green", False: "red", None: ""}


def parser():
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.accuracy", description=__doc__)
    made.add_argument("--seeds", type=int, default=4, help="seeds per drive; town has more (default: %(default)s)")
    made.add_argument("--first-seed", type=int, default=500, help="first seed; tune below 100 (default: %(default)s)")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: the cores)")
    made.add_argument("--folder", type=Path, default=ROOT / "logs" / "runs" / "accuracy", help="of rendered logs")
    made.add_argument("--page", type=Path, help="page whose tables are replaced")
    made.add_argument("--only", action="append", metavar="SECTION", help="only these sections; others stay")
    return made


def main():
    """Render, replay, measure, print."""
    arguments = parser().parse_args()
    figures = [figure for figure in FIGURES if not arguments.only or figure.section in arguments.only]
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
    lines = [(figure, figure.measured(results)) for figure in figures]
    shown = [line for figure, measured in lines for line in ((figure, measured), *figure.by_scene(results))]
    print_table(shown)
    print(summary(lines))
    print(f"{(time.monotonic() - started) / 60:.1f} minutes")
    if arguments.page:
        about = f"{results.about(figures)} {summary(lines)}."
        page = arguments.page.read_text(encoding="utf-8")
        changed = with_tables(page, shown, about, whole=not arguments.only)
        arguments.page.write_text(changed, encoding="utf-8")


def summary(lines):
    """A sentence with the number of required figures that are met."""
    verdicts = [measured.met for figure, measured in lines if figure.required]
    met, missing = verdicts.count(True), verdicts.count(None)
    return f"{met} of {len(verdicts)} required figures are met, {missing} could not be measured"


def print_table(lines):
    """Print one table with all sections."""
    table = Table(title="Accuracy", show_lines=False)
    for header in HEADERS:
        table.add_column(header, overflow="fold")
    for section, of_section in by_section(lines).items():
        table.add_section()
        table.add_row(f"[bold]{section}")
        for figure, measured in of_section:
            texts = (text.replace("[", r"\[") for text in cells(figure, measured))
            table.add_row(*texts, style=STYLES[measured.met])
    Console().print(table)


if __name__ == "__main__":
    main()
