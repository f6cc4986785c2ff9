"""Damages of a log, and the errors for logs that are damaged or are not MCAP."""

import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

from roadperc_stream.errors import LogError
from roadperc_stream.log.layout import MAGIC
from roadperc_stream.system.files import not_a_log
from roadperc_stream.system.time import ns_to_seconds

ZSTD: Final = b"\x28\xb5\x2f\xfd"
"""First bytes of a compressed file; no CDR message begins so."""
BAGS: Final = (b"SQLite f", b"#ROSBAG ")
"""First bytes of the files of ROS bags, as many as of MCAP."""
_TABLE: Final = b"PAR1"
_IMAGES: Final = (b"\xff\xd8\xff", b"\x89PNG")


def damaged(path: Path, fault: str) -> LogError:
    """Return the error for a damaged log. It names the command that shows what is intact, if the log is a file."""
    return LogError(f"{path}: {fault}{see_info(path)}")


def see_info(path: Path) -> str:
    """Return the hint to run roadperc-info, to append to an error; empty if the log is not a file."""
    return f"; run roadperc-info {shlex.quote(str(path))} to see what is intact" if path.is_file() else ""


def unopened(path: Path, error: OSError) -> LogError:
    """Return the error for a log that the system cannot open; for a folder it is that of ``not_a_log``."""
    return LogError(not_a_log(path) if path.is_dir() else f"{path}: {error.strerror or error}")


def require_magic(path: Path, start: bytes) -> None:
    """Check that a file or pipe starts as an MCAP log.

    ``start`` are as many of its first bytes as the magic has, fewer if there are no more. Errors name ``path``.

    Raises:
        LogError: it is empty, or not MCAP.
    """
    if not start:
        raise LogError(f"{path}: empty file, expected an MCAP log")
    if start != MAGIC:
        raise LogError(f"{path}: not an MCAP log (it does not start with the MCAP magic){_way_to_mcap(path, start)}")


def _way_to_mcap(path: Path, start: bytes) -> str:
    """Return the command that makes a log of another file, to append to an error."""
    name = shlex.quote(str(path))
    if start.startswith(ZSTD):
        return f"; decompress it with: zstd -d {name}"
    if start.startswith(BAGS):
        return f"; copy the bag to MCAP with: roadperc-replay {name} OUT.mcap"
    if start.startswith(_TABLE):
        return f"; it is a table: roadperc-report {name}"
    if start.startswith(_IMAGES):
        return f"; convert the folder of images with: roadperc-convert {shlex.quote(str(path.parent))} IN.mcap"
    is_named = path.suffix in ("", ".mcap")
    return "" if is_named else f"; if it is a video, convert it with: roadperc-convert {name} IN.mcap"


@dataclass(frozen=True)
class LostSpan:
    """First and last log time of lost messages, both included; None if unknown."""

    first_ns: int | None
    last_ns: int | None

    def overlaps(self, start_ns: int | None, end_ns: int | None) -> bool:
        """Return whether it has a log time from ``start_ns`` up to ``end_ns``; None is no limit."""
        ends_before = self.last_ns is not None and start_ns is not None and self.last_ns < start_ns
        starts_behind = self.first_ns is not None and end_ns is not None and self.first_ns >= end_ns
        return not (ends_before or starts_behind)

    def words(self, from_ns: int | None) -> str:
        """Return its times as text; seconds count from ``from_ns``."""
        ends = ("from", self.first_ns), ("to", self.last_ns)
        known = [f"{word} {_at(time_ns, from_ns)}" for word, time_ns in ends if time_ns is not None]
        return " ".join(known) or "at an unknown time"

    def with_more(self, other: "LostSpan") -> "LostSpan":
        """Return the span from the earlier start to the later end."""
        first_ns = None if None in (self.first_ns, other.first_ns) else min(self.first_ns or 0, other.first_ns or 0)
        last_ns = None if None in (self.last_ns, other.last_ns) else max(self.last_ns or 0, other.last_ns or 0)
        return LostSpan(first_ns, last_ns)

    def ending(self, last_ns: int) -> "LostSpan":
        """Return the span with an end, if it has none and does not begin later."""
        is_open = self.last_ns is None and (self.first_ns is None or self.first_ns <= last_ns)
        return LostSpan(self.first_ns, last_ns) if is_open else self


def _at(time_ns: int, from_ns: int | None) -> str:
    return f"{time_ns} ns" if from_ns is None else f"{ns_to_seconds(time_ns - from_ns):.3f} s ({time_ns} ns)"


@dataclass(frozen=True)
class Damage:
    """One damage of a file: its first byte, and a text that describes it."""

    byte: int
    words: str
    span: LostSpan | None = None
    """The messages that may be affected; None if none are, for example by a damaged attachment."""
    is_loss: bool = False
    """Whether messages in the span are lost; otherwise all were read, but may be wrong."""
    number: int = 1
    """Number of damages that it represents; the last listed one also represents all later ones."""

    def concerns(self, start_ns: int | None, end_ns: int | None) -> bool:
        """Return whether messages from ``start_ns`` up to ``end_ns`` may be affected; None is no limit."""
        return self.span is not None and self.span.overlaps(start_ns, end_ns)

    def with_more(self, other: "Damage") -> "Damage":
        """Return a damage that also represents a later one."""
        both = self.span and other.span and self.span.with_more(other.span)
        span, is_loss = both or self.span or other.span, self.is_loss or other.is_loss
        return Damage(self.byte, self.words, span, is_loss, self.number + other.number)


def number_of(damages: Iterable[Damage]) -> int:
    """Return the number of damages, including those that are not listed."""
    return sum(damage.number for damage in damages)


def first_damage(damages: Sequence[Damage]) -> str:
    """Return the text for the first damage, with the number of all."""
    number = number_of(damages)
    more = f" (the first of {number} damages)" if number > 1 else ""
    return f"damaged at byte {damages[0].byte}: {damages[0].words}{more}"


class DamagedLogError(LogError):
    """A damaged log of which some messages can be read; ``damages`` lists where."""

    def __init__(self, path: Path, damages: Sequence[Damage], can_be_saved: str) -> None:
        super().__init__(f"{path}: {first_damage(damages)}; {can_be_saved}{see_info(path)}")
        self.path, self.damages, self.can_be_saved = path, tuple(damages), can_be_saved

    def __reduce__(self) -> tuple[type[Self], tuple[Any, ...]]:
        """Pickle the error by its arguments: worker processes raise it too."""
        return type(self), (self.path, self.damages, self.can_be_saved)


def nothing_saved(path: Path, damages: Sequence[Damage]) -> LogError:
    """Return the error for a log of which no message can be read."""
    return damaged(path, f"{first_damage(damages)}; no message can be saved" if damages else "holds no message")


ANY_TIME: Final = LostSpan(None, None)
_MOST_LISTED: Final = 1000
"""Damages that are listed individually."""


@dataclass
class Losses:
    """The messages read and the damages found until now. A loss without a known end ends at the next message."""

    counts: Counter[int] = field(default_factory=Counter)
    """Messages by channel."""
    first_ns: int | None = None
    last_ns: int | None = None
    damages: list[Damage] = field(default_factory=list)
    """In file order."""
    last_good_ns: int | None = None
    """Log time of the last message before the first damage."""
    _behind_ns: int = 0
    """Largest step back of log time from an earlier message to a later one."""
    _open_from: int = _MOST_LISTED
    """Number of the first damage whose end is not known."""

    @property
    def unread(self) -> LostSpan:
        """The times of messages that are lost before the next one is read."""
        return LostSpan(None if self.last_ns is None else self.last_ns - self._behind_ns, None)

    @property
    def gaps(self) -> tuple[LostSpan, ...]:
        """The log times at which messages are lost, in file order."""
        return tuple(dict.fromkeys(damage.span for damage in self.damages if damage.span and damage.is_loss))

    def count(self, channel_id: int, log_time_ns: int) -> None:
        """Count a message; it ends the losses before it."""
        self.counts[channel_id] += 1
        latest_ns = log_time_ns if self.last_ns is None else self.last_ns
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        if self.last_ns is not None:
            self._behind_ns = max(self._behind_ns, latest_ns - log_time_ns)
        self.last_ns = max(latest_ns, log_time_ns)
        if not self.damages:
            self.last_good_ns = log_time_ns
        if self._open_from < _MOST_LISTED:
            self._end(log_time_ns + self._behind_ns)

    def note(self, byte: int, words: str, span: LostSpan | None = None, *, is_loss: bool = False) -> None:
        """Add a damage; the last listed one also stands for all later ones."""
        damage = Damage(byte, words, span, is_loss)
        if len(self.damages) == _MOST_LISTED:
            self.damages[-1] = self.damages[-1].with_more(damage)
        else:
            self.damages.append(damage)
        if span is not None and span.last_ns is None:
            self._open_from = min(self._open_from, len(self.damages) - 1)

    def _end(self, last_ns: int) -> None:
        for number in range(self._open_from, len(self.damages)):
            damage = self.damages[number]
            if damage.span is not None and damage.span.last_ns is None:
                span = LostSpan(damage.span.first_ns, max(last_ns, damage.span.first_ns or 0))
                self.damages[number] = replace(damage, span=span)
        self._open_from = _MOST_LISTED
