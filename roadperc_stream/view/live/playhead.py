"""Where playback is and what comes next: pure decisions on log time and the clock's time.

Log times and clock times are integer nanoseconds; the rate is log seconds per second.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Final

from roadperc_stream.system.time import NS_PER_S

TICK_S: Final = 0.1
"""Longest wait while playing, so that the viewer's clock moves through gaps of the log."""
EDGE_POLL_S: Final = 0.05
"""How often to look for more of a log that is being written."""
RESUME_LEAD_S: Final = 0.25
"""How much must be computed, in seconds of playback, before playback goes on from the edge: otherwise it stutters."""
LOOP_PAUSE_S: Final = 0.5
"""How long the end is seen before playback starts over; what was sent arrives meanwhile."""


SLOWEST: Final = 1e-3
FASTEST: Final = 1e3
"""Log seconds per second."""


class Status(Enum):
    """What playback does."""

    PLAYING = auto()
    PAUSED = auto()
    WAITING = auto()
    """At the edge of what is computed."""
    ENDED = auto()


@dataclass(frozen=True)
class Reach:
    """The part of a log that can be played now; a complete one gets no longer."""

    first_ns: int
    last_ns: int
    complete: bool = True

    def clamp(self, log_ns: int) -> int:
        """The nearest log time within."""
        return max(self.first_ns, min(log_ns, self.last_ns))


@dataclass(frozen=True)
class Playhead:
    """Playback was at ``log_ns`` when the clock said ``clock_ns``, and goes on from there as its status says."""

    status: Status
    log_ns: int
    clock_ns: int
    rate: float = 1.0

    def at(self, clock_ns: int) -> int:
        """Log time at a time of the clock."""
        if self.status is not Status.PLAYING:
            return self.log_ns
        return self.log_ns + round((clock_ns - self.clock_ns) * self.rate)

    def turned(self, status: Status, log_ns: int, clock_ns: int) -> "Playhead":
        """The same rate with another status, from this log time on."""
        return Playhead(status, log_ns, clock_ns, self.rate)


@dataclass(frozen=True)
class Order:
    """What a viewer asks for; ``seek_ns`` is None where it stays."""

    play: bool
    rate: float
    seek_ns: int | None = None


@dataclass(frozen=True)
class Move:
    """What to do next: send the next message, start over, or wait (None: until somebody asks)."""

    playhead: Playhead
    send: bool = False
    restart: bool = False
    """Playback is back where it starts over from: those who watch are to forget what was shown."""
    wait_s: float | None = 0.0


def obey(playhead: Playhead, order: Order, reach: Reach, clock_ns: int) -> tuple[Playhead, bool]:
    """Carry out what a viewer asks for.

    Playing from the end starts over; a rate that is no positive number changes nothing, one beyond what is played
    becomes the slowest or the fastest that is.

    Returns:
        Where playback is now, and whether it went elsewhere.
    """
    now_ns, seek_ns = playhead.at(clock_ns), order.seek_ns
    if order.play and seek_ns is None and reach.complete and now_ns >= reach.last_ns:
        seek_ns = reach.first_ns
    possible = math.isfinite(order.rate) and order.rate > 0
    rate = min(max(order.rate, SLOWEST), FASTEST) if possible else playhead.rate
    status = Status.PLAYING if order.play else Status.PAUSED
    log_ns = reach.clamp(now_ns if seek_ns is None else seek_ns)
    return Playhead(status, log_ns, clock_ns, rate), seek_ns is not None


def decide(playhead: Playhead, next_ns: int | None, reach: Reach, clock_ns: int, *, loop_ns: int | None = None) -> Move:
    """What to do next.

    A message is due once playback has come to its log time, so one whose time goes back is due at once.

    Args:
        playhead: where playback is.
        next_ns: log time of the next message, None where there is none yet or none any more.
        reach: what can be played; taken before the next message was looked for.
        clock_ns: the clock's time.
        loop_ns: log time to start over from at the end, None to stay there.
    """
    if playhead.status is Status.WAITING:
        return _at_the_edge(playhead, reach, clock_ns)
    if playhead.status is Status.ENDED and loop_ns is not None:
        return _at_the_end(playhead, clock_ns, loop_ns)
    if playhead.status is not Status.PLAYING:
        return Move(playhead, wait_s=None)
    now_ns = playhead.at(clock_ns)
    if next_ns is None:
        return _out_of_messages(playhead, reach, clock_ns, loop_ns)
    if next_ns <= now_ns:
        return Move(playhead, send=True)
    return Move(playhead, wait_s=min((next_ns - now_ns) / playhead.rate / NS_PER_S, TICK_S))


def _at_the_edge(playhead: Playhead, reach: Reach, clock_ns: int) -> Move:
    lead_ns = RESUME_LEAD_S * playhead.rate * NS_PER_S
    if reach.complete or reach.last_ns - playhead.log_ns >= lead_ns:
        return Move(replace(playhead, status=Status.PLAYING, clock_ns=clock_ns))
    return Move(playhead, wait_s=EDGE_POLL_S)


def _at_the_end(playhead: Playhead, clock_ns: int, loop_ns: int) -> Move:
    wait_ns = playhead.clock_ns + round(LOOP_PAUSE_S * NS_PER_S) - clock_ns
    if wait_ns > 0:
        return Move(playhead, wait_s=wait_ns / NS_PER_S)
    return Move(playhead.turned(Status.PAUSED, loop_ns, clock_ns), restart=True, wait_s=None)


def _out_of_messages(playhead: Playhead, reach: Reach, clock_ns: int, loop_ns: int | None) -> Move:
    if not reach.complete:
        edge_ns = reach.clamp(playhead.at(clock_ns))
        return Move(playhead.turned(Status.WAITING, edge_ns, clock_ns), wait_s=EDGE_POLL_S)
    wait_s = None if loop_ns is None else LOOP_PAUSE_S
    return Move(playhead.turned(Status.ENDED, reach.last_ns, clock_ns), wait_s=wait_s)


@dataclass(frozen=True)
class PlaybackOptions:
    """How a log is served."""

    rate: float = 1.0
    """Log seconds per second."""
    loop: bool = False
    host: str = "127.0.0.1"
    port: int = 8765
    """0 for a free one."""
    start_s: float = 0.0
    """Where playback starts, counted from the log's first message."""
