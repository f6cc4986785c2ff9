"""Texts that name files: paths, addresses with a scheme such as ``s3://bucket/drives``, and patterns.

Patterns follow the rules of shells and of Python's glob: ``*``, ``?``, ``[..]`` and ``**``. A pattern matches a hidden
file or folder only with a part that begins with a dot itself. A folder that matches stands for all files below it.
"""

import os
import re
from fnmatch import fnmatchcase
from typing import Final

from roadperc_stream.errors import StorageError

Parts = tuple[str, ...]
_HERE: Final = "file://"
_MAGIC: Final = re.compile(r"[*?\[]")
_NUMBER: Final = re.compile(r"([0-9]+)")


def is_address(text: str) -> bool:
    """Whether a text names a file or a folder of a store; ``file://`` is this machine."""
    return "://" in text and not _is_here(text)


def local_path(text: str) -> str:
    """The path of a text that is no address; ``file://`` and ``file://localhost`` before it are left out.

    Raises:
        StorageError: it names a file of another machine.
    """
    path = text[len(_HERE) :].removeprefix("localhost") if _is_here(text) else text
    if _is_here(text) and not path.startswith("/"):
        raise StorageError(f"{text}: expected a file of this machine, such as file:///drives/a.mcap")
    return path


def _is_here(text: str) -> bool:
    return text[: len(_HERE)].lower() == _HERE


def whole(text: str) -> str:
    """An address without slashes at its end, or the absolute path of a path or of ``file://``.

    Letters stand for themselves, as in the stores' own programs: ``%20`` is no blank, ``?`` no query.

    Raises:
        StorageError: it names nothing, or a file of another machine.
    """
    scheme, _, path = text.partition("://")
    if "\0" in text or not text or (is_address(text) and not path.strip("/")):
        raise StorageError(f"{text!r}: expected the path or the address of a file or a folder")
    if is_address(text):
        return f"{scheme.lower()}://{path.rstrip('/')}"
    return os.path.abspath(local_path(text))  # noqa: PTH100 - pathlib's keeps what ".." stands for


def split_pattern(address: str) -> tuple[str, Parts]:
    """The folder before the first part that is a pattern, and the parts from there on; empty without a pattern."""
    parts = address.split("/")
    first = next((k for k, part in enumerate(parts) if _MAGIC.search(part)), len(parts))
    return "/".join(parts[:first]) or "/", tuple(parts[first:])


def left_of(pattern: Parts, names: Parts) -> set[Parts]:
    """What may be left of a pattern behind a path's names.

    It holds ``()`` where the pattern matches the path or a folder above; it is empty where nothing below can match.
    """
    left = {pattern}
    for name in names:
        left = {rest for parts in left for rest in _behind(parts, name)}
    return left


def _behind(pattern: Parts, name: str) -> set[Parts]:
    is_hidden = name.startswith(".")
    if not pattern:
        return set() if is_hidden else {()}
    if pattern[0] == "**":
        return _behind(pattern[1:], name) | (set() if is_hidden else {pattern})
    is_named = fnmatchcase(name, pattern[0]) and (pattern[0].startswith(".") or not is_hidden)
    return {pattern[1:]} if is_named else set()


def natural(address: str) -> tuple[list[str | int], str]:
    """The key that sorts ``drive2`` before ``drive10``."""
    parts = _NUMBER.split(address)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], address
