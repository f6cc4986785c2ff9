"""A job over many items in several threads: each item goes through the same steps, one after the other.

Every step takes the items in order, one at a time, and may keep a state between them. The results depend neither on the
number of threads nor on their speed. No step has its own thread: a free thread takes the next step that can begin.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Condition, Thread
from typing import Any, Final, Generic, TypeVar

import numpy as np

T = TypeVar("T")
U = TypeVar("U")
_SPARE: Final = 1
"""Items under way beyond one for each thread, that whoever is done finds another one: more gain nothing."""
_END: Final = object()
"""What the first step gives behind the last item."""
_BEFORE_ALL: Final = -1
"""Number of an item that there is not."""
_WAKES_EVERY_S: Final = 0.5
"""Longest delay of a signal."""


@dataclass(frozen=True)
class Pipeline(Generic[T]):
    """Items, and the steps that each of them goes through."""

    items: Iterator[Any]
    steps: tuple[Callable[[Any], Any], ...] = ()

    def then(self, step: Callable[[T], U]) -> "Pipeline[U]":
        """The same with one more step, which takes what the one before gives."""
        return Pipeline(self.items, (*self.steps, step))

    def run(self, threads: int) -> None:
        """Take all items through all steps.

        Args:
            threads: how many share the work; 1: everything is done in the caller's. No thread outlives this.

        Raises:
            Exception: an item's error, the one that a single thread would have met first; all items before it are
                complete then.
        """
        if threads > 1:
            _Work(self, threads).run()
            return
        for item in self.items:
            made = item
            for step in self.steps:
                made = step(made)


class _Work:
    """The steps of a pipeline, shared by several threads; the first step takes the next item from the iterator."""

    def __init__(self, pipeline: Pipeline[Any], threads: int) -> None:
        self._steps = (lambda _: next(pipeline.items, _END), *pipeline.steps)
        self._threads = min(threads, len(self._steps))
        self._changed = Condition()
        self._waiting = tuple(deque[tuple[int, Any]]() for _ in self._steps)
        self._waiting[0].append((0, None))
        self._busy = [False] * len(self._steps)
        self._under_way = 0
        self._failed: tuple[int, BaseException] | None = None
        self._is_stopped = False

    def run(self) -> None:
        """Do all of it in threads of their own.

        The caller's takes no lock: a signal that comes between the taking and the block that gives it back would let
        the others wait for ever. It only waits, and wakes now and then, for a signal can come just before a wait.
        """
        ended = SimpleQueue[None]()
        helpers = [Thread(target=self._help, args=(ended,), name=f"roadperc_{n}") for n in range(self._threads)]
        try:
            for helper in helpers:
                helper.start()
            for _ in helpers:
                while not _comes(ended):
                    pass
        finally:  # those that are at a step end after it, and wake those that wait for it
            self._is_stopped = True
            for helper in filter(Thread.is_alive, helpers):
                helper.join()
        if self._failed is not None:
            raise self._failed[1]

    def _help(self, ended: SimpleQueue[None]) -> None:
        """Work in a thread in which numpy is as silent as in ``one_thread``: that setting is a thread's own."""
        try:
            with np.errstate(all="ignore"):
                self._work()
        except BaseException as error:  # not of a step: out of memory when handing on a result, for example
            with self._changed:
                self._failed, self._is_stopped = (_BEFORE_ALL, error), True
                self._changed.notify_all()
        finally:
            ended.put(None)

    def _work(self) -> None:
        """Do what is next until nothing is left."""
        while (begun := self._begun()) is not None:
            step, number, item = begun
            try:
                made = self._steps[step](item)
            except BaseException as error:
                self._fail(step, number, error)
            else:
                self._pass_on(step, number, made)

    def _begun(self) -> tuple[int, int, Any] | None:
        """The next step that can begin, with the item and its number; None where nothing is left to do."""
        with self._changed:
            while (step := self._next_step()) is None:
                if self._is_stopped or not any(self._busy):
                    return None
                self._changed.wait()
            self._busy[step] = True
            self._under_way += step == 0
            return step, *self._waiting[step].popleft()

    def _next_step(self) -> int | None:
        """The last step that can begin: what is nearly done goes first, and little is under way."""
        last_first = reversed(range(len(self._steps)))
        return None if self._is_stopped else next(filter(self._can_begin, last_first), None)

    def _can_begin(self, step: int) -> bool:
        if self._busy[step] or not self._waiting[step]:
            return False
        number, _ = self._waiting[step][0]
        is_needed = self._failed is None or number < self._failed[0]
        return is_needed and (step > 0 or self._under_way < self._threads + _SPARE)

    def _fail(self, step: int, number: int, error: BaseException) -> None:
        with self._changed:
            self._busy[step] = False
            if self._failed is None or number < self._failed[0]:
                self._failed = number, error
            self._changed.notify_all()

    def _pass_on(self, step: int, number: int, made: Any) -> None:
        """Hand to the next step what one made; behind the first step the next item is taken."""
        with self._changed:
            self._busy[step] = False
            if made is not _END and step == 0:
                self._waiting[0].append((number + 1, None))
            if made is _END or step + 1 == len(self._steps):
                self._under_way -= 1
            else:
                self._waiting[step + 1].append((number, made))
            self._changed.notify_all()


def _comes(ended: SimpleQueue[None]) -> bool:
    try:
        ended.get(timeout=_WAKES_EVERY_S)
    except Empty:
        return False
    return True
