"""Paths, and addresses with a scheme such as ``s3://bucket/logs``."""

import os
import re
from typing import Final

from roadperc_stream.errors import StorageError

_FILE_SCHEME: Final = "file://"
_MAGIC: Final = re.compile(r"[*?\[]")
_NUMBER: Final = re.compile(r"([0-9]+)")


def is_address(text: str) -> bool:
    """Whether a text names a file or a folder of a store; ``file://`` is this machine."""
    return "://" in text and not text.lower().startswith(_FILE_SCHEME)


def local_path(text: str) -> str:
    """The path in a text that is not an address, without ``file://`` or ``file://localhost``.

    Raises:
        StorageError: it names a file of another machine.
    """
    if not text.lower().startswith(_FILE_SCHEME):
        return text
    path = text[len(_FILE_SCHEME) :].removeprefix("localhost")
    if not path.startswith("/"):
        raise StorageError(f"{text}: expected a file of this machine, such as file:///logs/a.mcap")
    return path


def whole(text: str) -> str:
    """The address without trailing slashes, or the absolute path of a path or of ``file://``.

    Characters are taken literally, as in the stores' own programs: ``%20`` is not a blank, ``?`` starts no query.

    Raises:
        StorageError: it names nothing, or a file of another machine.
    """
    scheme, _, path = text.partition("://")
    if "\0" in text or not text or (is_address(text) and not path.strip("/")):
        raise StorageError(f"{text!r}: expected the path or the address of a file or a folder")
    if is_address(text):
        return f"{scheme.lower()}://{path.rstrip('/')}"
    return os.path.abspath(local_path(text))  # noqa: PTH100 - pathlib does not resolve ".."


def split_pattern(address: str) -> tuple[str, str]:
    """The folder before the first part with a pattern, and the pattern from there on; empty without a pattern."""
    parts = address.split("/")
    first = next((k for k, part in enumerate(parts) if _MAGIC.search(part)), len(parts))
    return "/".join(parts[:first]) or "/", "/".join(parts[first:])


def natural(address: str) -> tuple[list[str | int], str]:
    """The key that sorts ``log2`` before ``log10``."""
    parts = _NUMBER.split(address)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], address
