"""Numbers that the code names or assumes stay as recorded: constants, default values of fields and of arguments.

Most of them are limits, periods and thresholds, of which other tests notice only large changes. After an intended
change, ``pytest tests/test_recorded.py --force-regen`` replaces the recording; review its difference.
"""

import inspect
import re
from importlib import import_module
from pathlib import Path

import numpy as np

import roadperc_stream

ROOT = Path(roadperc_stream.__file__).parent
MOST_CHARACTERS = 1200
"""Longer constants are tables that are made of others."""


def test_the_numbers_of_all_modules_equal_the_recorded_ones(file_regression):
    found = {}
    for path in sorted([*ROOT.rglob("*.py"), *ROOT.glob("eval/**/*.py"), *ROOT.glob("tools/**/*.py")]):
        name = ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")
        if "_pb2" not in name and not name.endswith("__main__"):
            found[name] = sorted(numbers_of(import_module(name), path.read_text("utf-8")))
    file_regression.check("\n".join(f"{name}\n  " + "\n  ".join(lines) for name, lines in found.items() if lines))


def numbers_of(module, source):
    """Lines with the constants, fields and arguments that a module defines."""
    for name in re.findall(r"^(?!TYPE)(_?[A-Z][A-Z0-9_]*)\b.* = ", source, re.MULTILINE):
        yield from line_of(name, getattr(module, name, None))
    for name, made in vars(module).items():
        if getattr(made, "__module__", "") == module.__name__:
            functions = {name: made, **(vars(made) if inspect.isclass(made) else {})}
            for function in functions.values():
                for argument in arguments_of(function):
                    yield from line_of(f"{function.__qualname__}({argument.name})", argument.default)


def arguments_of(function):
    is_own = inspect.isfunction(function) or (inspect.isclass(function) and hasattr(function, "__dataclass_fields__"))
    is_made = getattr(function, "__name__", "") == "__init__"  # by dataclass, whose fields are listed
    return inspect.signature(function).parameters.values() if is_own and not is_made else ()


def line_of(name, value):
    """A line, if the value has numbers outside of texts."""
    text = repr(value.tolist() if isinstance(value, np.ndarray | np.generic) else value)
    text = re.sub(r"\d+\.\d{9,}(e-?\d+)?", lambda found: f"{float(found[0]):.8g}", text)  # of other libraries
    bare = re.sub(r"\b[a-zA-Z]\w*\b(?<!True)(?<!False)|'[^']*'|\"[^\"]*\"", "", text)
    is_known = "LimitsConfig(" in text or not {"<", "\\"}.isdisjoint(bare)  # elsewhere, or no number
    if re.search(r"\d|True|False", bare) and len(text) <= MOST_CHARACTERS and not is_known:
        yield f"{name} = {text}"
