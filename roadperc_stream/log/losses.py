"""Which messages a damaged log lost, as far as it says: by message indexes, spans of chunks, or what comes next."""

import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import IO, Final

from mcap.exceptions import McapError
from mcap.opcode import Opcode

from roadperc_stream.log.inventory import Positions, read_message_index

_RECORD: Final = struct.Struct("<BQ")
_MOST_INDEX_BYTES: Final = 64 * 1024 * 1024


@dataclass(frozen=True)
class Gap:
    """Log times between which messages were lost, both included; None where nothing says so.

    ``messages`` are those lost by channel, empty where nothing says so.
    """

    first_ns: int | None
    last_ns: int | None
    messages: Mapping[int, int] = field(default_factory=dict)


def expected_messages(stream: IO[bytes], at: int) -> Positions:
    """What the message indexes say that start at a byte of a file; nothing where none do."""
    expected = Positions()
    stream.seek(at)
    while len(head := stream.read(_RECORD.size)) == _RECORD.size:
        opcode, length = _RECORD.unpack(head)
        if opcode != Opcode.MESSAGE_INDEX or length > _MOST_INDEX_BYTES:
            break
        try:
            channel_id, positions = read_message_index(stream.read(length))
        except (McapError, ValueError):
            break
        expected[channel_id] = positions
    return expected


def lost_in_chunk(
    expected: Positions, saved: Positions, span_ns: tuple[int, int] | None, next_ns: int | None, *, all_read: bool
) -> Gap | None:
    """What a damaged chunk lost; None where it lost nothing.

    Args:
        expected: its messages, by the message indexes behind it; empty where there are none.
        saved: those that were read.
        span_ns: first and last log time, by the index or its own head; None where both make no sense.
        next_ns: earliest log time of what follows the last message read.
        all_read: whether it ended where it should, and each of its messages was read.
    """
    if any(expected.values()):
        lost = {number: set(places) - set(saved.get(number, ())) for number, places in expected.items()}
        times = [time_ns for places in lost.values() for time_ns, _ in places]
        counts = {number: len(places) for number, places in lost.items() if places}
        return Gap(min(times), max(times), counts) if times else None
    if all_read:
        return None
    if span_ns is None:
        return Gap(next_ns, None)
    if not any(saved.values()) or next_ns is None:
        return Gap(*span_ns)
    first_ns = max(span_ns[0], next_ns)
    return Gap(first_ns, max(span_ns[1], first_ns))


@dataclass
class Losses:
    """The gaps of a log while it is read; where no end is known, the next message shows it."""

    gaps: list[Gap] = field(default_factory=list)
    undescribed: Counter[int] = field(default_factory=Counter)
    """Messages of channels that nothing describes, by channel."""
    _undescribed_ns: tuple[int, int] | None = None
    """Their first and last log time."""
    _is_open: bool = False

    @property
    def all(self) -> tuple[Gap, ...]:
        """The gaps, and the span of the messages that nothing describes."""
        return (*self.gaps, *(() if self._undescribed_ns is None else (Gap(*self._undescribed_ns),)))

    def add_undescribed(self, channel_id: int, log_time_ns: int) -> None:
        """Take note of a message of a channel that nothing describes."""
        self.undescribed[channel_id] += 1
        first_ns, last_ns = self._undescribed_ns or (log_time_ns, log_time_ns)
        self._undescribed_ns = min(first_ns, log_time_ns), max(last_ns, log_time_ns)

    def add(self, gap: Gap, *, is_open: bool) -> None:
        """Take note of a gap; an open one ends where the next message is."""
        first_ns = self.gaps.pop().first_ns if self._is_open else gap.first_ns  # open: no message came since
        self.gaps.append(Gap(first_ns, None if is_open else gap.last_ns, gap.messages))
        self._is_open = is_open

    def settle(self, last_ns: int) -> bool:
        """A message was read, which what an open gap lost is no later than.

        Returns:
            Whether there was one.
        """
        was_open, self._is_open = self._is_open, False
        if was_open:
            first_ns = self.gaps[-1].first_ns
            self.gaps[-1] = replace(self.gaps[-1], last_ns=max(last_ns, 0 if first_ns is None else first_ns))
        return was_open
