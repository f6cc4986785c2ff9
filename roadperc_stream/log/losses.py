"""Counts the messages of a log while it is read, and keeps its damages with the times of the lost messages."""

from collections import Counter, deque
from dataclasses import dataclass, field, replace
from typing import Final

from roadperc_stream.log.damage import Damage, LostSpan

ANY_TIME: Final = LostSpan(None, None)
_MOST_LISTED: Final = 1000
"""Damages that are listed individually."""
_FAR_NS: Final = 24 * 3600 * 1_000_000_000
"""Limit for the time between messages of a log, to recognise one."""


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
    _behind_ns: int = -1
    """Largest step back of log time from an earlier message to a later one; -1 if log times strictly ascend."""
    _recent: deque[int] = field(default_factory=lambda: deque(maxlen=3))
    """The last log times; one of them may be damaged."""
    _open_from: int = _MOST_LISTED
    """Number of the first damage whose end is not known."""
    _doubts: set[int] = field(default_factory=set)

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
        self._recent.append(log_time_ns)
        latest_ns = log_time_ns if self.last_ns is None else self.last_ns
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        if self.last_ns is not None:
            self._behind_ns = max(self._behind_ns, latest_ns - log_time_ns)
        self.last_ns = max(latest_ns, log_time_ns)
        if not self.damages:
            self.last_good_ns = log_time_ns
        if self._open_from < _MOST_LISTED:
            self._end(log_time_ns + self._behind_ns)

    def is_near(self, log_time_ns: int) -> bool:
        """Return whether a message may have this log time, judged by the last ones."""
        return not self._recent or any(abs(log_time_ns - near_ns) < _FAR_NS for near_ns in self._recent)

    def note(self, byte: int, words: str, span: LostSpan | None = None, *, is_loss: bool = False) -> None:
        """Add a damage; the last listed one also stands for all later ones."""
        damage = Damage(byte, words, span, is_loss)
        if len(self.damages) == _MOST_LISTED:
            self.damages[-1] = self.damages[-1].with_more(damage)
        else:
            self.damages.append(damage)
        if span is not None and span.last_ns is None:
            self._open_from = min(self._open_from, len(self.damages) - 1)

    def note_doubt(self, byte: int, words: str) -> None:
        """Add a loss that is none if the CRC of the data section is correct."""
        self.note(byte, words, self.unread, is_loss=True)
        self._doubts.add(byte)

    def dispel_doubts(self) -> None:
        """Remove the doubts: the CRC of the data section is correct."""
        self.damages[:] = [damage for damage in self.damages if damage.byte not in self._doubts]

    def spare_messages(self) -> None:
        """Note that damages at any time affect no message: the CRCs of all chunks are correct, or name the chunk."""
        for number, damage in enumerate(self.damages):
            if damage.span == ANY_TIME and not damage.is_loss:
                self.damages[number] = replace(damage, span=None)

    def _end(self, last_ns: int) -> None:
        for number in range(self._open_from, len(self.damages)):
            damage = self.damages[number]
            if damage.span is not None and damage.span.last_ns is None:
                span = LostSpan(damage.span.first_ns, max(last_ns, damage.span.first_ns or 0))
                self.damages[number] = replace(damage, span=span)
        self._open_from = _MOST_LISTED
