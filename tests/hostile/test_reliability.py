"""Every promise of docs/reliability.md names tests, and these exist."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reliability.md").read_text("utf-8")
NAMED = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def functions(path):
    return {node.name for node in ast.parse((ROOT / path).read_text("utf-8")).body if isinstance(node, ast.FunctionDef)}


def test_the_tests_that_are_named_exist():
    named = NAMED.findall(PAGE)
    assert [f"{path}::{name}" for path, name in named if name not in functions(path)] == []
    assert len(named) > 30


def test_every_promise_names_a_test():
    rows = [line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("| promise")]
    assert [line for line in rows if not NAMED.search(line)] == []
    assert len(rows) > 25
