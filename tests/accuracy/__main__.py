"""Measures the figures of docs/accuracy.md and prints them with the required values, or writes them into the page."""

import argparse
import os
import re
import time
from functools import partial
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.accuracy.drives import ROOT
from tests.accuracy.figures import FIGURES
from tests.accuracy.running import remove_replays, run

SEEDS = 4
BLOCK = re.compile(r"(<!-- figures -->\n).*?(<!-- end -->)", re.DOTALL)
VERDICTS = {True: "yes", False: "no", None: ""}
HEADERS = ("figure", "required", "measured", "coverage", "met")
FIRST_SEED = 200


def parser():
    """The command line."""
    made = argparse.ArgumentParser("python -m tests.accuracy", description=__doc__)
    made.add_argument("--seeds", type=int, default=SEEDS, help=f"seeds per drive; town has more (default: {SEEDS})")
    made.add_argument("--first-seed", type=int, default=FIRST_SEED, help="first seed; tune below 100 (default: 200)")
    made.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes (default: the cores)")
    made.add_argument("--folder", type=Path, default=ROOT / "logs" / "runs" / "accuracy", help="of rendered logs")
    made.add_argument("--page", type=Path, help="page whose tables are replaced")
    made.add_argument(
        "--only", action="append", metavar="SECTION", help="only sections that begin with this; others stay"
    )
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
        page = arguments.page.read_text(encoding="utf-8")
        of_figures = partial(about, results)
        if arguments.only:
            page = with_sections(page, lines, of_figures)
        else:
            page = with_figures(page, lines, of_figures(figures))
        arguments.page.write_text(page, encoding="utf-8")


def about(results, figures):
    """A sentence with the seeds and the number of frames of some figures."""
    names = {scenario.name for figure in figures for scenario in figure.scenarios}
    replays = [replay for name in names for replay in results.replays.get(name, ())]
    if not replays:
        return "No frames replayed."
    seeds = sorted({replay.seed for replay in replays})
    frames = sum(replay.frames.height for replay in replays)
    return f"Seeds {seeds[0]} to {seeds[-1]}, {frames} frames replayed."


def cells(figure, measured):
    """The cells of a line."""
    return figure.name, figure.required, measured.text, measured.coverage, VERDICTS[measured.met]


def summary(lines):
    """A sentence with the number of required figures that are met."""
    required = [(figure, measured) for figure, measured in lines if figure.required]
    met = sum(bool(measured.met) for _, measured in required)
    missing = sum(measured.met is None for _, measured in required)
    return f"{met} of {len(required)} required figures are met, {missing} could not be measured"


def print_table(lines):
    """Print one table with all sections."""
    table = Table(title="Accuracy", show_lines=False)
    for header in HEADERS:
        table.add_column(header, overflow="fold")
    for section, group in groupby(lines, key=lambda line: line[0].section):
        table.add_section()
        table.add_row(f"[bold]{section}")
        for figure, measured in group:
            style = {True: "green", False: "red", None: ""}[measured.met]
            table.add_row(*(text.replace("[", r"\[") for text in cells(figure, measured)), style=style)
    console = Console()
    console.print(table)
    console.print(summary(lines))


def with_figures(page, lines, about):
    """The page with its tables replaced.

    Raises:
        ValueError: the page has no markers for the tables.
    """
    text = f"{about} {summary(lines).capitalize()}.\n\n" + "\n".join(markdown(lines))
    changed, count = BLOCK.subn(lambda block: f"{block[1]}{text}{block[2]}", page)
    if count != 1:
        raise ValueError("expected one <!-- figures --> with an <!-- end --> in the page")
    return changed


def with_sections(page, lines, about):
    """The page with the tables of some sections replaced or added; ``about`` gives a sentence about some figures.

    Raises:
        ValueError: the page has no markers for the tables.
    """
    for section, group in groupby(lines, key=lambda line: line[0].section):
        of_section = list(group)
        head, *rows = markdown(of_section)
        text = "\n".join((head, about([figure for figure, _ in of_section]) + "\n", *rows, ""))
        table = re.compile(rf"### {re.escape(section)}\n.*?(?=### |<!-- end -->)", re.DOTALL)
        page, count = table.subn(lambda _, text=text: text, page)
        if not count:
            if "<!-- end -->" not in page:
                raise ValueError("expected an <!-- end --> in the page")
            page = page.replace("<!-- end -->", f"\n{text}<!-- end -->")
    return page


def markdown(lines):
    """Lines of Markdown: a table per section."""
    for section, group in groupby(lines, key=lambda line: line[0].section):
        yield f"### {section}\n"
        yield f"| {' | '.join(HEADERS)} |\n|---|---|---|---|---|"
        yield from (f"| {' | '.join(cells(*line))} |" for line in group)
        yield ""


if __name__ == "__main__":
    main()
