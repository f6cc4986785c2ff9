"""The figures as a table on the terminal, and in a page between two marks."""

import re
from itertools import groupby

from rich.console import Console
from rich.table import Table

BLOCK = re.compile(r"(<!-- figures -->\n).*?(<!-- end -->)", re.DOTALL)
VERDICTS = {True: "yes", False: "no", None: ""}
HEADERS = ("figure", "required", "measured", "coverage", "met")


def rows(figures, results):
    """A line of cells for each figure."""
    return [(figure, figure.measured(results)) for figure in figures]


def cells(figure, measured):
    """The texts of a line."""
    return figure.name, figure.required, measured.text, measured.coverage, VERDICTS[measured.met]


def summary(lines):
    """How many of the figures that something is required of are met."""
    required = [(figure, measured) for figure, measured in lines if figure.required]
    met = sum(measured.met is True for _, measured in required)
    missing = sum(measured.met is None for _, measured in required)
    return f"{met} of {len(required)} required figures are met, {missing} could not be measured"


def print_table(lines):
    """One table with a section after the other."""
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
    """A page with the tables of a run in the place of those of an earlier one.

    Raises:
        ValueError: the page has no place for them.
    """
    text = f"{about} {summary(lines).capitalize()}.\n\n" + "\n".join(markdown(lines))
    changed, count = BLOCK.subn(lambda block: f"{block[1]}{text}{block[2]}", page)
    if count != 1:
        raise ValueError("expected one <!-- figures --> with an <!-- end --> in the page")
    return changed


def markdown(lines):
    """Lines of Markdown: a table a section."""
    for section, group in groupby(lines, key=lambda line: line[0].section):
        yield f"### {section}\n"
        yield f"| {' | '.join(HEADERS)} |\n|---|---|---|---|---|"
        yield from (f"| {' | '.join(cells(*line))} |" for line in group)
        yield ""
