"""Writes the tables of docs/reliability.md: every promise and its tests, from the tests' markers.

``python -m tests.promises`` updates the page; ``make pages`` calls it.
"""

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reliability.md"
TABLE = re.compile(r"(<!-- promises: (.*?) -->\n).*?(<!-- end -->)", re.DOTALL)


@cache
def marked() -> list[tuple[str, str, str]]:
    """(section, promise, test) of every ``pytest.mark.promise``."""
    found = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        tree = ast.parse(path.read_text("utf-8"))
        for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
            for mark in function.decorator_list:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.promise":
                    section, promise = map(ast.literal_eval, mark.args)
                    found.append((section, promise, f"{path.relative_to(ROOT).as_posix()}::{function.name}"))
    return found


def written(page: str) -> str:
    """The page with updated tables.

    Raises:
        ValueError: the page has no table for a section.
    """
    sections: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for section, promise, test in marked():
        sections[section][promise].append(f"`{test}`")
    if missing := sections.keys() - {title for _, title, _ in TABLE.findall(page)}:
        raise ValueError(f"{PAGE.name} has no table for {sorted(missing)}")

    def table(found: re.Match[str]) -> str:
        rows = [f"| {promise} | {', '.join(tests)} |\n" for promise, tests in sections[found[2]].items()]
        return found[1] + "\n| promise | test |\n|---|---|\n" + "".join(rows) + "\n" + found[3]

    return TABLE.sub(table, page)


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text("utf-8")), "utf-8")
