"""The player: one thread that sends a log's messages at their time; viewers' orders change the playhead at once."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from threading import Event, Lock
from typing import Final, Protocol

from roadperc_stream.log import Message
from roadperc_stream.system.time import ns_to_seconds
from roadperc_stream.view.live.playhead import Move, Order, Playhead, Status, decide, obey
from roadperc_stream.view.live.source import Source, held


@dataclass(frozen=True)
class Answer:
    """What became of an order: where playback is now and whether it went elsewhere."""

    playhead: Playhead
    moved: bool


class Audience(Protocol):
    """Those who watch."""

    def send(self, message: Message) -> None:
        """Show a message."""
        ...

    def time(self, log_ns: int) -> None:
        """Tell what log time it is."""
        ...

    def state(self, answer: Answer) -> None:
        """Tell that playback changed by itself."""
        ...

    def warn(self, text: str) -> None:
        """Tell what could not be done."""
        ...

    def restart(self) -> None:
        """Have all that was shown forgotten; who still watches subscribes again."""
        ...


LONGEST_WAIT_S: Final = 0.5
"""A signal that comes just before a wait is handled only after it."""


class Player:
    """Plays a source to an audience from a log time on, once somebody watches.

    Any thread may call ``watch``, ``control`` and ``stop``. They never wait for the disk: the thread in ``run`` reads.
    """

    def __init__(
        self,
        source: Source,
        clock_ns: Callable[[], int],
        *,
        start_ns: int,
        rate: float = 1.0,
        loop: bool = False,
        asked: Event | None = None,
    ) -> None:
        self._source, self._clock_ns, self._asked = source, clock_ns, asked or Event()
        self._loop_ns = start_ns if loop else None
        self._lock = Lock()
        """Guards what viewers change: the five below."""
        self._playhead = Playhead(Status.PAUSED, start_ns, clock_ns(), rate)
        self._watched = self._stopped = False
        self._fresh = set[str]()
        """Topics to show to new subscribers."""
        self._sought: Order | None = None
        """The newest order that moved the playhead and is not carried out yet."""
        self._follow_from(start_ns + 1)  # what holds at the start is shown to the first who watch

    def watch(self, topic: str) -> None:
        """Show a topic to a new subscriber."""
        with self._lock:
            self._fresh.add(topic)
        self._asked.set()

    def control(self, order: Order) -> Answer:
        """Move the playhead as a viewer asks; ``run`` shows the messages there, or those of a newer order."""
        with self._lock:
            self._playhead, moved = obey(self._playhead, order, self._source.reach(), self._clock_ns())
            self._watched = True
            self._sought = order if moved else self._sought
            answer = Answer(self._playhead, moved)
        self._asked.set()
        return answer

    def stop(self) -> None:
        """End ``run``."""
        self._stopped = True
        self._asked.set()

    def run(self, audience: Audience) -> None:
        """Play until ``stop``.

        Raises:
            LogError: the log can no longer be read.
        """
        self._audience = audience
        wait_s: float | None = 0.0
        while True:
            self._asked.wait(LONGEST_WAIT_S if wait_s is None else min(wait_s, LONGEST_WAIT_S))
            self._asked.clear()
            if self._stopped:
                return
            self._seek()
            self._welcome()
            wait_s = self._advance()

    def _seek(self) -> None:
        """Show what holds at the newest time sought, and go on from there."""
        with self._lock:
            order, self._sought, log_ns = self._sought, None, self._playhead.log_ns
        if order is None:
            return
        reach, asked_ns = self._source.reach(), order.seek_ns
        if asked_ns is not None and asked_ns > reach.last_ns and not reach.complete:
            beyond_s = ns_to_seconds(asked_ns - reach.last_ns)
            self._audience.warn(f"computed only up to {beyond_s:.1f} s before the time asked for: playing from there")
        self._audience.time(log_ns)
        self._show_held({channel.topic for channel in self._source.channels}, log_ns)
        self._follow_from(log_ns + 1)

    def _welcome(self) -> None:
        """Show what holds to new subscribers; the first ones start playback."""
        with self._lock:
            if self._sought or not self._fresh:
                return  # a seek shows all topics
            fresh, self._fresh = self._fresh, set()
            clock_ns = self._clock_ns()
            now_ns = self._playhead.at(clock_ns)
            status = self._playhead.status if self._watched else Status.PLAYING
            self._watched, self._playhead = True, self._playhead.turned(status, now_ns, clock_ns)
        coming = self._peek()
        self._audience.time(now_ns)  # who comes when all is played, or while it stands, knows no time yet
        self._show_held(fresh, min(now_ns, coming.log_time_ns - 1) if coming else now_ns)
        self._audience.state(Answer(self._playhead, moved=False))

    def _show_held(self, topics: Collection[str], log_ns: int) -> None:
        for message in held(self._source, topics, log_ns):
            self._audience.send(message)

    def _follow_from(self, log_ns: int) -> None:
        self._coming: Iterator[Message | None] = self._source.follow(log_ns)
        self._next: Message | None = None

    def _peek(self) -> Message | None:
        self._next = self._next or next(self._coming, None)
        return self._next

    def _advance(self) -> float | None:
        """Do what is due.

        Returns:
            Seconds to the next time there is something to do, None where only an order changes anything.
        """
        reach = self._source.reach()
        coming = self._peek()
        next_ns = coming.log_time_ns if coming else None
        with self._lock:
            if self._sought:
                return 0.0  # the next message is not that of the playhead any more
            before = self._playhead
            move = decide(before, next_ns, reach, self._clock_ns(), loop_ns=self._loop_ns)
            self._playhead, self._watched = move.playhead, self._watched and not move.restart
        self._carry_out(move)
        if move.playhead.status is not before.status:
            self._audience.state(Answer(self._playhead, moved=move.restart))
        return move.wait_s

    def _carry_out(self, move: Move) -> None:
        if move.restart:  # wait for subscribers, as at first: viewers that know no seek would join the end to the start
            self._audience.restart()
            self._follow_from(move.playhead.log_ns + 1)
        elif move.send and self._next:
            self._audience.send(self._next)
            self._next = None
        elif move.playhead.status is Status.PLAYING:
            self._audience.time(move.playhead.at(self._clock_ns()))
