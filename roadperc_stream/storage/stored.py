"""A file as a listing tells of it."""

from dataclasses import dataclass
from uuid import uuid4


@dataclass(frozen=True)
class StoredFile:
    """A file that was found.

    Attributes:
        address: its absolute path, or its address with a scheme.
        size_bytes: its length.
        fingerprint: differs from an earlier one whenever the content may; equal where nobody wrote the file.
    """

    address: str
    size_bytes: int
    fingerprint: str


def fingerprint(size_bytes: int, modified_ns: int | None) -> str:
    """Size and time of change; where a store tells no time, a text that is never seen again."""
    return f"{size_bytes}:{uuid4().hex if modified_ns is None else modified_ns}"
