"""Measures the figures of docs/accuracy.md and prints them with the required values, or writes them into the page."""

import argparse
import os
import re
import time
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.accuracy.drives import ROOT
from tests.accuracy.figures import FIGURES
from tests.accuracy.running import remove_replays, run

BLOCK = re.compile(r"(?<=<!-- figures -->\n)(.*?)(?=<!-- end -->)", re.DOTALL)
VERDICTS = {True: "yes", False: "no", None: ""}
STYLES = {True: "green", False: "red", None: ""}
HEADERS = ("figure", "required", "measured", "coverage", "met")


def parser():
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.accuracy", description=__doc__)
    made.add_argument("--seeds", type=int, default=4, help="seeds per drive; town has more (default: %(default)s)")
    made.add_argument("--first-seed", type=int, default=200, help="first seed; tune below 100 (default: %(default)s)")
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
    print_table(lines)
    print(f"{(time.monotonic() - started) / 60:.1f} minutes")
    if arguments.page:
        about = f"{results.about(figures)} {summary(lines)}."
        page = arguments.page.read_text(encoding="utf-8")
        changed = with_tables(page, lines, about, whole=not arguments.only)
        arguments.page.write_text(changed, encoding="utf-8")


def summary(lines):
    """A sentence with the number of required figures that are met."""
    verdicts = [measured.met for figure, measured in lines if figure.required]
    met, missing = verdicts.count(True), verdicts.count(None)
    return f"{met} of {len(verdicts)} required figures are met, {missing} could not be measured"


def cells(figure, measured):
    """The cells of a line."""
    return figure.name, figure.required, measured.text, measured.coverage, VERDICTS[measured.met]


def by_section(lines):
    """Sections with their lines."""
    return {section: list(group) for section, group in groupby(lines, key=lambda line: line[0].section)}


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
    print(summary(lines))


def with_tables(page, lines, about, *, whole):
    """The page with new tables after the sentence ``about``, or with the tables of some sections replaced or added.

    Raises:
        ValueError: the page has no markers for the tables.
    """
    found = BLOCK.search(page)
    if found is None:
        raise ValueError("expected <!-- figures --> and <!-- end --> in the page")
    head, *old = re.split(r"^(?=### )", found[0], flags=re.MULTILINE)
    tables = {} if whole else {text.partition("\n")[0].removeprefix("### "): text.strip() for text in old}
    for section, of_section in by_section(lines).items():
        rows = "\n".join(f"| {' | '.join(cells(*line))} |" for line in of_section)
        sentence = "" if whole else f"{about}\n\n"
        tables[section] = f"### {section}\n\n{sentence}| {' | '.join(HEADERS)} |\n|---|---|---|---|---|\n{rows}"
    block = "\n\n".join(filter(None, (about if whole else head.strip(), *tables.values())))
    return f"{page[: found.start()]}{block}\n{page[found.end() :]}"


if __name__ == "__main__":
    main()
