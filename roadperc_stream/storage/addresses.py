"""Texts that name a file or a folder: a path, or an address with a scheme such as ``s3://bucket/drives``."""

import os
import re
from typing import Final
from urllib.parse import unquote

from roadperc_stream.errors import StorageError

_SCHEME: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_LOCAL: Final = "file"


def is_address(text: str) -> bool:
    """Whether a text begins with the scheme of a store; ``file://`` is this machine."""
    return scheme_of(text) not in {"", _LOCAL}


def scheme_of(text: str) -> str:
    """What stands before ``://``, in lower case; empty for a path."""
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
    if not is_address(text):
        return os.path.abspath(_local(text))  # noqa: PTH100 - pathlib's keeps what ".." stands for
    rest = text.partition("://")[2].rstrip("/")
    if not rest:
        raise StorageError(f"{text}: expected the name of a bucket behind {scheme_of(text)}://")
    return f"{scheme_of(text)}://{rest}"


def joined(folder: str, name: str) -> str:
    """The address of a file in a folder.

    Raises:
        StorageError: the name would lead out of the folder, or is none.
    """
    if name.startswith("/") or "\\" in name or "\0" in name or {"", ".", ".."} & set(name.split("/")):
        raise StorageError(f"{folder}: {name!r} is not the name of a file below this folder")
    return f"{folder.rstrip('/')}/{name}"


def _local(text: str) -> str:
    """The path that a text without a store's scheme stands for."""
    if not text:
        raise StorageError("expected the path or the address of a file, found an empty text")
    if scheme_of(text) != _LOCAL:
        return text
    host, slash, path = text.partition("://")[2].partition("/")
    if host not in {"", "localhost"} or not slash:
        raise StorageError(f"{text}: expected a file of this machine, such as file:///drives/a.mcap")
    return unquote(f"/{path}")
