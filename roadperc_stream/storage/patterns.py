"""Which files a text with ``*``, ``?``, ``[..]`` or ``**`` stands for, by the rules of shells and of Python's glob.

A hidden file or folder is meant only by a part that begins with a dot itself. A folder that a pattern stands for is
all that is in it.
"""

import re
from fnmatch import fnmatchcase
from typing import Final

Parts = tuple[str, ...]
_MAGIC: Final = re.compile(r"[*?\[]")
_NUMBER: Final = re.compile(r"([0-9]+)")


def split_pattern(address: str) -> tuple[str, Parts]:
    """The folder before the first part that is a pattern, and the parts from there on; none without a pattern."""
    parts = address.split("/")
    first = next((k for k, part in enumerate(parts) if _MAGIC.search(part)), len(parts))
    return "/".join(parts[:first]) or "/", tuple(parts[first:])


def matches(pattern: Parts, names: Parts) -> bool:
    """Whether a pattern stands for the file of these names, or for a folder that it is in."""
    if not pattern or not names:
        return not pattern and not any(map(is_hidden, names))
    if pattern[0] == "**":
        below = not is_hidden(names[0]) and matches(pattern, names[1:])
        return below or matches(pattern[1:], names)
    return _is_named(pattern[0], names[0]) and matches(pattern[1:], names[1:])


def leads_on(pattern: Parts, folder: Parts) -> bool:
    """Whether a pattern may stand for something in the folder of these names."""
    if not folder or not pattern:
        return not any(map(is_hidden, folder))
    if pattern[0] == "**":
        below = not is_hidden(folder[0]) and leads_on(pattern, folder[1:])
        return below or leads_on(pattern[1:], folder)
    return _is_named(pattern[0], folder[0]) and leads_on(pattern[1:], folder[1:])


def is_hidden(name: str) -> bool:
    """Whether a file or a folder is left out where nobody names it."""
    return name.startswith(".")


def natural(address: str) -> tuple[list[str | int], str]:
    """What sorts ``drive2`` before ``drive10``."""
    parts = _NUMBER.split(address)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], address


def _is_named(pattern: str, name: str) -> bool:
    return fnmatchcase(name, pattern) and (pattern.startswith(".") or not is_hidden(name))
