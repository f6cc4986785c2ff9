"""The tables of docs/accuracy.md: figures of several cases are a table with a row for each case, the others a list."""

import re
from collections import defaultdict
from itertools import groupby

BLOCK = re.compile(r"(?<=<!-- figures -->\n)(.*?)(?=<!-- end -->)", re.DOTALL)
VERDICTS = {True: "yes", False: "no", None: ""}
HEADERS = ("figure", "required", "measured", "coverage", "met")


def cells(figure, measured):
    """The cells of a line."""
    return figure.name, figure.required, measured.text, measured.coverage, VERDICTS[measured.met]


def by_section(lines):
    """Sections with their lines."""
    return {section: list(group) for section, group in groupby(lines, key=lambda line: line[0].section)}


def with_tables(page, lines, about, *, whole):
    """The page with new tables after the sentence ``about``, or with the tables of some sections replaced or added.

    Raises:
        ValueError: the page has no markers for the tables.
    """
    block = BLOCK.search(page)
    if block is None:
        raise ValueError("expected <!-- figures --> and <!-- end --> in the page")
    head, *old = re.split(r"^(?=### )", block[0], flags=re.MULTILINE)
    found = {} if whole else {text.partition("\n")[0].removeprefix("### "): text.strip() for text in old}
    for section, of_section in by_section(lines).items():
        found[section] = "\n\n".join((f"### {section}", *([] if whole else [about]), tables(of_section)))
    text = "\n\n".join(filter(None, (about if whole else head.strip(), *found.values())))
    return f"{page[: block.start()]}{text}\n{page[block.end() :]}"


def tables(lines):
    """Markdown of a section's lines; a figure's name is ``figure`` or ``case: figure``."""
    by_name = defaultdict(dict)
    for figure, measured in lines:
        case, _, name = figure.name.rpartition(": ")
        by_name[name][case] = (figure, measured)
    shared = {name: of_case for name, of_case in by_name.items() if len(of_case) > 1}
    alone = [cells(*line) for name, of_case in by_name.items() if name not in shared for line in of_case.values()]
    cases = dict.fromkeys(figure.name.rpartition(": ")[0] for figure, _ in lines)
    found = (with_cases(shared, cases) if shared else [], [HEADERS, *alone] if alone else [])
    return "\n\n".join(markdown(rows) for rows in found if rows)


def with_cases(shared, cases):
    """Rows of cases in their order and columns of figures, or the reverse if there are more figures."""
    required = {name: {figure.required for figure, _ in of_case.values()} for name, of_case in shared.items()}
    heads = [f"{name} ({''.join(texts)})" if len(texts) == 1 else name for name, texts in required.items()]
    rows = [("case", *(head.removesuffix(" ()") for head in heads), "coverage")]
    for case in (case for case in cases if any(case in of_case for of_case in shared.values())):
        row = {name: of_case[case] for name, of_case in shared.items() if case in of_case}
        texts = (cell(*row[name], len(required[name]) > 1) if name in row else "" for name in shared)
        rows.append((case or "all scenes", *texts, coverage(row.values())))
    if not any(row[-1] for row in rows[1:]):
        rows = [row[:-1] for row in rows]
    return rows if len(rows) > len(shared) else list(zip(*rows, strict=True))


def cell(figure, measured, says_required):
    """The measured value, bold if it misses the required one."""
    text = f"**{measured.text}**" if measured.met is False else measured.text
    return f"{text}; {figure.required}" if says_required and figure.required else text


def coverage(lines):
    """The coverage of a row: once if it is the same for all figures."""
    found = [measured.coverage for _, measured in lines if measured.coverage]
    return ", ".join(found if len(set(found)) > 1 else found[:1])


def markdown(rows):
    """A table whose first row is the head."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join((lines[0], f"|{'---|' * len(rows[0])}", *lines[1:]))
