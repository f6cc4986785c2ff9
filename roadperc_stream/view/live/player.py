"""The player: one thread that sends a log's messages at their time and does what viewers ask."""

from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from threading import Event
from typing import Final, Protocol

from roadperc_stream.core.time import ns_to_seconds
from roadperc_stream.log import Message
from roadperc_stream.view.live.playhead import Move, Order, Playhead, Status, decide, obey
from roadperc_stream.view.live.source import Source, held


@dataclass(frozen=True)
class Answer:
    """What became of an order: where playback is now and whether it went elsewhere."""

    playhead: Playhead
    moved: bool


@dataclass(frozen=True)
class Request:
    """An order and where its answer goes."""

    order: Order
    answer: Future[Answer] = field(default_factory=Future)


@dataclass(frozen=True)
class Subscribed:
    """Somebody wants to see a topic."""

    topic: str


@dataclass(frozen=True)
class Stop:
    """Playback ends."""


Word = Request | Subscribed | Stop


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
"""For which a signal may go unheeded."""


class Inbox:
    """What is asked of the player, from any thread."""

    def __init__(self) -> None:
        self._words = SimpleQueue[Word]()
        self._closed = Event()

    def put(self, word: Word) -> None:
        """Leave a word; a request to a player that has ended is cancelled."""
        self._words.put(word)
        if self._closed.is_set():
            self.close()

    def take(self, wait_s: float | None) -> list[Word]:
        """All there is, after a wait for the first: as long as is said, None without end, but now and then for nothing.

        A signal that comes just before a wait is heeded only after it.
        """
        words = list[Word]()
        with suppress(Empty):
            words.append(self._words.get(timeout=LONGEST_WAIT_S if wait_s is None else min(wait_s, LONGEST_WAIT_S)))
            while True:
                words.append(self._words.get_nowait())
        return words

    def close(self) -> None:
        """Nobody reads it any more: cancel what is asked."""
        self._closed.set()
        for word in self.take(0):
            if isinstance(word, Request):
                word.answer.cancel()


class Player:
    """Plays a source to an audience from a log time on, once somebody watches.

    All decisions are made in the thread that calls ``run``; others leave a word in the inbox.
    """

    def __init__(
        self,
        source: Source,
        audience: Audience,
        inbox: Inbox,
        clock_ns: Callable[[], int],
        *,
        start_ns: int,
        rate: float = 1.0,
        loop: bool = False,
    ) -> None:
        self._source, self._audience, self._inbox, self._clock_ns = source, audience, inbox, clock_ns
        self._loop_ns, self._watched = start_ns if loop else None, False
        self._playhead = Playhead(Status.PAUSED, start_ns, clock_ns(), rate)
        self._follow_from(start_ns + 1)  # what holds at the start is shown to the first who watch

    def run(self) -> None:
        """Play until asked to stop.

        Raises:
            LogError: the log can no longer be read.
        """
        wait_s: float | None = 0.0
        try:
            while True:
                words = self._inbox.take(wait_s)
                if any(isinstance(word, Stop) for word in words):
                    return
                self._heed(words)
                wait_s = self._advance()
        finally:
            self._inbox.close()

    def stop(self) -> None:
        """End ``run``, from any thread."""
        self._inbox.put(Stop())

    def _heed(self, words: list[Word]) -> None:
        fresh = {word.topic for word in words if isinstance(word, Subscribed)}
        if fresh:
            self._welcome(fresh)
        for word in words:
            if isinstance(word, Request):
                self._obey(word)

    def _welcome(self, topics: Collection[str]) -> None:
        """Show what holds to those who came late; the first ones start playback."""
        clock_ns = self._clock_ns()
        now_ns = self._playhead.at(clock_ns)
        status = self._playhead.status if self._watched else Status.PLAYING
        self._watched, self._playhead = True, self._playhead.turned(status, now_ns, clock_ns)
        coming = self._peek()
        self._audience.time(now_ns)  # who comes when all is played, or while it stands, knows no time yet
        self._show_held(topics, min(now_ns, coming.log_time_ns - 1) if coming else now_ns)
        self._audience.state(Answer(self._playhead, moved=False))

    def _obey(self, request: Request) -> None:
        reach, asked_ns = self._source.reach(), request.order.seek_ns
        self._watched = True
        self._playhead, moved = obey(self._playhead, request.order, reach, self._clock_ns())
        request.answer.set_result(Answer(self._playhead, moved))
        if asked_ns is not None and asked_ns > reach.last_ns and not reach.complete:
            beyond_s = ns_to_seconds(asked_ns - reach.last_ns)
            self._audience.warn(f"computed only up to {beyond_s:.1f} s before the time asked for: playing from there")
        if moved:
            self._go_to(self._playhead.log_ns)

    def _go_to(self, log_ns: int) -> None:
        self._audience.time(log_ns)
        self._show_held({channel.topic for channel in self._source.channels}, log_ns)
        self._follow_from(log_ns + 1)

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
        before = self._playhead
        move = decide(before, next_ns, reach, self._clock_ns(), loop_ns=self._loop_ns)
        self._playhead = move.playhead
        self._carry_out(move)
        if move.playhead.status is not before.status:
            self._audience.state(Answer(move.playhead, moved=move.restart))
        return move.wait_s

    def _start_over(self, log_ns: int) -> None:
        """Wait for somebody to watch, as at first: viewers that know no seek would join the end to the start."""
        self._audience.restart()
        self._watched = False
        self._follow_from(log_ns + 1)

    def _carry_out(self, move: Move) -> None:
        if move.restart:
            self._start_over(move.playhead.log_ns)
        elif move.send and self._next:
            self._audience.send(self._next)
            self._next = None
        elif move.playhead.status is Status.PLAYING:
            self._audience.time(move.playhead.at(self._clock_ns()))
