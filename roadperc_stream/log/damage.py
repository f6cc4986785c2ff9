"""Where a log is damaged or no MCAP log at all, and the errors that say so."""

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from roadperc_stream.errors import LogError
from roadperc_stream.log.layout import MAGIC
from roadperc_stream.system.files import not_a_log


def damaged(path: Path, what: str) -> LogError:
    """The error of a log that is not whole; of a file it names the command that says what can still be read."""
    return LogError(f"{path}: {what}{says_more(path)}")


def says_more(path: Path) -> str:
    """The command that says where a log is damaged, behind other words; nothing of what is no file."""
    return f"; roadperc-info {shlex.quote(str(path))} tells what is whole" if path.is_file() else ""


def unopened(path: Path, error: OSError) -> LogError:
    """The error of a log that the system does not open; of a folder, what to do with it."""
    return LogError(not_a_log(path) if path.is_dir() else f"{path}: {error.strerror or error}")


def require_log(path: Path, stream: IO[bytes]) -> None:
    """Refuse a file that does not even start as an MCAP log; the stream is then at the first record.

    Raises:
        LogError: it is empty, or something else.
    """
    stream.seek(0)
    require_magic(path, stream.read(len(MAGIC)))


def require_magic(path: Path, magic: bytes) -> None:
    """Refuse what does not start as an MCAP log.

    Args:
        path: of the file or the pipe.
        magic: its first bytes, as many as the magic has, or all there are.

    Raises:
        LogError: it is empty, or something else.
    """
    if not magic:
        raise LogError(f"{path}: empty file, expected an MCAP log")
    if magic != MAGIC:
        raise LogError(f"{path}: not an MCAP log (it does not start with the MCAP magic)")


@dataclass(frozen=True)
class Damage:
    """Where a file is not what it should be, and how.

    ``first_ns`` and ``last_ns`` are the log times of the messages that it may concern, None without a limit; where it
    concerns none, as in the index, ``of_messages`` is false.
    """

    byte: int
    words: str
    first_ns: int | None = None
    last_ns: int | None = None
    of_messages: bool = True
    number: int = 1
    """Damages that it stands for: of very many, the last one that is listed stands for all from there on."""

    def concerns(self, start_ns: int | None, end_ns: int | None) -> bool:
        """Whether messages from ``start_ns`` up to ``end_ns`` may be among those, None without a limit."""
        ends_before = self.last_ns is not None and start_ns is not None and self.last_ns < start_ns
        starts_behind = self.first_ns is not None and end_ns is not None and self.first_ns >= end_ns
        return self.of_messages and not (ends_before or starts_behind)

    def with_more(self, other: "Damage") -> "Damage":
        """A damage that also stands for one behind it."""
        first_ns = None if None in (self.first_ns, other.first_ns) else min(self.first_ns or 0, other.first_ns or 0)
        last_ns = None if None in (self.last_ns, other.last_ns) else max(self.last_ns or 0, other.last_ns or 0)
        of_messages = self.of_messages or other.of_messages
        return Damage(self.byte, self.words, first_ns, last_ns, of_messages, self.number + other.number)


def number_of(damages: Iterable[Damage]) -> int:
    """How many they are, those included that are not listed one by one."""
    return sum(damage.number for damage in damages)


class DamagedLogError(LogError):
    """A log that is damaged, of which something can be read all the same: ``damages`` are where."""

    def __init__(self, path: Path, damages: Sequence[Damage], can_be_saved: str) -> None:
        super().__init__(f"{path}: {_first(damages)}; {can_be_saved}{says_more(path)}")
        self.path, self.damages, self.can_be_saved = path, tuple(damages), can_be_saved

    def __reduce__(self) -> tuple[type[Self], tuple[Any, ...]]:
        """As it is made: it comes out of other processes too."""
        return type(self), (self.path, self.damages, self.can_be_saved)


def nothing_saved(path: Path, damages: Sequence[Damage]) -> LogError:
    """The error of a log of which not one message can be read."""
    return damaged(path, f"{_first(damages)}; no message can be saved" if damages else "holds no message")


def _first(damages: Sequence[Damage]) -> str:
    number = number_of(damages)
    more = f" (the first of {number} damages)" if number > 1 else ""
    return f"damaged at byte {damages[0].byte}: {damages[0].words}{more}"
