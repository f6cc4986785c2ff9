"""Texts that name files: paths, addresses with a scheme such as ``s3://bucket/drives``, and patterns.

Patterns follow the rules of shells and of Python's glob: ``*``, ``?``, ``[..]`` and ``**``. A hidden file or folder is
meant only by a part that begins with a dot itself. A folder that a pattern stands for is all that is in it.
"""

import os
import re
from fnmatch import fnmatchcase
from typing import Final
from urllib.parse import unquote

from roadperc_stream.errors import StorageError

Parts = tuple[str, ...]
_SCHEME: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_LOCAL: Final = "file"
_MAGIC: Final = re.compile(r"[*?\[]")
_NUMBER: Final = re.compile(r"([0-9]+)")


def is_address(text: str) -> bool:
    """Whether a text begins with the scheme of a store; ``file://`` is this machine."""
    return scheme_of(text) not in {"", _LOCAL}


def scheme_of(text: str) -> str:
    """The text before ``://``, in lower case; empty for a path."""
    found = _SCHEME.match(text)
    return found[1].lower() if found else ""


def whole(text: str) -> str:
    """An address without slashes at its end, or the absolute path that a path or ``file://`` stands for.

    Letters of an address stand for themselves, as in the stores' own programs: ``%20`` is no blank, ``?`` no query.

    Raises:
        StorageError: it names another machine's file, or nothing.
    """
    if "\0" in text:
        raise StorageError(f"{text!r}: no name of a file has a zero byte")
    scheme, rest = scheme_of(text), text.partition("://")[2]
    if not text:
        raise StorageError("expected the path or the address of a file, found an empty text")
    if is_address(text):
        if not rest.rstrip("/"):
            raise StorageError(f"{text}: expected the name of a bucket behind {scheme}://")
        return f"{scheme}://{rest.rstrip('/')}"
    if scheme == _LOCAL:
        host, slash, path = rest.partition("/")
        if host not in {"", "localhost"} or not slash:
            raise StorageError(f"{text}: expected a file of this machine, such as file:///drives/a.mcap")
        text = unquote(f"/{path}")
    return os.path.abspath(text)  # noqa: PTH100 - pathlib's keeps what ".." stands for


def joined(folder: str, name: str) -> str:
    """The address of a file in a folder.

    Raises:
        StorageError: the name would lead out of the folder, or is empty.
    """
    if name.startswith("/") or "\\" in name or "\0" in name or {"", ".", ".."} & set(name.split("/")):
        raise StorageError(f"{folder}: {name!r} is not the name of a file below this folder")
    return f"{folder.rstrip('/')}/{name}"


def split_pattern(address: str) -> tuple[str, Parts]:
    """The folder before the first part that is a pattern, and the parts from there on; empty without a pattern."""
    parts = address.split("/")
    first = next((k for k, part in enumerate(parts) if _MAGIC.search(part)), len(parts))
    return "/".join(parts[:first]) or "/", tuple(parts[first:])


def matches(pattern: Parts, names: Parts) -> bool:
    """Whether a pattern stands for the file of these names, or for a folder that it is in."""
    if not pattern or not names:
        return not pattern and not any(map(_is_hidden, names))
    if pattern[0] == "**":
        below = not _is_hidden(names[0]) and matches(pattern, names[1:])
        return below or matches(pattern[1:], names)
    return _is_named(pattern[0], names[0]) and matches(pattern[1:], names[1:])


def leads_on(pattern: Parts, folder: Parts) -> bool:
    """Whether a pattern may stand for something in the folder of these names."""
    if not folder or not pattern:
        return not any(map(_is_hidden, folder))
    if pattern[0] == "**":
        below = not _is_hidden(folder[0]) and leads_on(pattern, folder[1:])
        return below or leads_on(pattern[1:], folder)
    return _is_named(pattern[0], folder[0]) and leads_on(pattern[1:], folder[1:])


def natural(address: str) -> tuple[list[str | int], str]:
    """The key that sorts ``drive2`` before ``drive10``."""
    parts = _NUMBER.split(address)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], address


def _is_hidden(name: str) -> bool:
    return name.startswith(".")


def _is_named(pattern: str, name: str) -> bool:
    return fnmatchcase(name, pattern) and (pattern.startswith(".") or not _is_hidden(name))
