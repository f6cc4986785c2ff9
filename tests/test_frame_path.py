"""The table of docs/architecture.md: a depth image passes the functions that it names, in that order."""

import functools
import inspect
import re
import sys
from pathlib import Path

from roadperc_stream.config import load_config
from tests import logs
from tests.replaying import replay

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PACKAGE = "roadperc_stream"
MOST_TYPES = 9


def noting(function, row, calls):
    """The function; it also appends `row` to `calls` when it starts, a generator whenever it goes on."""

    def generator(*args, **kwargs):
        calls.append(row)
        for item in function(*args, **kwargs):
            yield item
            calls.append(row)

    def call(*args, **kwargs):
        calls.append(row)
        return function(*args, **kwargs)

    return functools.wraps(function)(generator if inspect.isgeneratorfunction(function) else call)


def note_calls(rows, monkeypatch):
    """The list to which each call of a function in `rows` appends its (room, function).

    Not a profile function: frame objects that it gets crash Python 3.11.2 in a garbage collection.
    """
    calls = []
    modules = [module for name, module in sys.modules.items() if name.split(".")[0] == PACKAGE]
    for room, name in rows:
        owner, _, attribute = name.rpartition(".")
        noted = {}
        for holder in {getattr(module, owner, None) if owner else module for module in modules} - {None}:
            found = vars(holder).get(attribute)
            function = found.fget if isinstance(found, property) else found
            if inspect.isfunction(function) and function.__module__.split(".")[1] == room:
                noted[function] = noted.get(function) or noting(function, (room, name), calls)
                replacement = property(noted[function]) if function is not found else noted[function]
                monkeypatch.setattr(holder, attribute, replacement)
    return calls


def test_a_depth_image_passes_the_functions_of_the_page_in_order(tmp_path, monkeypatch):
    rows = re.findall(r"^\| `(\w+)` \| `([\w.]+)` \|", PAGE, re.MULTILINE)
    assert len(rows) > 20
    source = logs.write(tmp_path / "in.mcap", logs.items(2, road=logs.SMALL))
    noted = note_calls(rows, monkeypatch)
    replay(source, tmp_path / "out.mcap", load_config())
    calls = iter(noted)
    for row in rows:
        assert row in calls, f"{row} is not called after the rows before it"


def test_a_frame_passes_few_types():
    """Between the bytes of a message and the row of the table."""
    (listed,) = re.findall(r"between the bytes of the log and the row: (.*?)\. `tests", PAGE, re.DOTALL)
    types = re.findall(r"`(\w+)`", listed)
    assert len(types) <= MOST_TYPES
    table = PAGE.partition("## From an image to a cell")[2].partition("The image passes")[0]
    passed = dict.fromkeys(re.findall(r"`([A-Z]\w+)`", table))
    assert [name for name in passed if name != "FrameMetrics"] == types
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / PACKAGE).rglob("*.py"))
    for name in passed:
        assert re.search(rf"^class {name}\b", sources, re.MULTILINE), name
