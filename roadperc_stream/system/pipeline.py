"""A pipeline of steps over many items, run by several threads.

Every step takes the items in order, one at a time, and may keep a state between them. The results depend neither on the
number of threads nor on their speed. Steps have no threads of their own: a free thread takes the next step that can
start.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Condition, Thread
from time import monotonic
from typing import Any, Final, Generic, TypeVar

import numpy as np

T = TypeVar("T")
U = TypeVar("U")
_SPARE: Final = 1
"""Items in progress beyond one per thread, so that a free thread finds work; more do not help."""
_END: Final = object()
"""The result of the first step after the last item."""
_BEFORE_ALL: Final = -1
"""A number before that of the first item."""
_WAKES_EVERY_S: Final = 0.5
"""Longest delay of a signal."""
_POLL_S: Final = 0.02
PATIENCE_S: Final = 0.7
"""Longest wait for threads after Ctrl-C: code of the user may never return."""


@dataclass(frozen=True)
class Pipeline(Generic[T]):
    """Items, and the steps for each of them.

    ``apart`` uses another thread even if one is enough, so that the caller's thread handles signals during any step.
    """

    items: Iterator[Any]
    steps: tuple[Callable[[Any], Any], ...] = ()
    apart: bool = False

    def then(self, step: Callable[[T], U]) -> "Pipeline[U]":
        """A pipeline with one more step, which takes the result of the previous step."""
        return Pipeline(self.items, (*self.steps, step), self.apart)

    def run(self, threads: int) -> None:
        """Run all steps on all items.

        Args:
            threads: number of threads; 1 uses the caller's thread. They end before the call returns, unless one does
                not return from a step within ``PATIENCE_S`` after Ctrl-C.

        Raises:
            Exception: the error that a single thread would meet first; all items before it are complete.
        """
        if threads > 1 or self.apart:
            _Work(self, threads).run()
            return
        for item in self.items:
            for step in self.steps:
                item = step(item)  # noqa: PLW2901


class _Work:
    """The steps of a pipeline, shared by several threads; the first step takes the next item from the iterator."""

    def __init__(self, pipeline: Pipeline[Any], threads: int) -> None:
        self._steps = (lambda _: next(pipeline.items, _END), *pipeline.steps)
        self._threads = min(threads, len(self._steps))
        self._changed = Condition()
        self._waiting = tuple(deque[tuple[int, Any]]() for _ in self._steps)
        self._waiting[0].append((0, None))
        self._busy = [False] * len(self._steps)
        self._in_progress = 0
        self._failed: tuple[int, BaseException] | None = None
        self._is_stopped = False

    def run(self) -> None:
        """Run the steps in new threads.

        The caller's thread takes no lock: a signal between taking and releasing it would block the others forever. The
        caller waits with a timeout, because a signal can arrive just before a wait.
        """
        ended = SimpleQueue[None]()
        names = [f"roadperc_{n}" for n in range(self._threads)]
        helpers = [Thread(target=self._help, args=(ended,), name=name, daemon=True) for name in names]
        until_s = None
        try:
            for helper in helpers:
                helper.start()
            for _ in helpers:
                while not _has_ended(ended):
                    pass
        except KeyboardInterrupt:
            until_s = monotonic() + PATIENCE_S
            raise
        finally:  # a thread in a step ends after it, and wakes the waiting threads
            self._is_stopped = True
            for helper in filter(Thread.is_alive, helpers):
                while helper.is_alive() and (self._busy[-1] or until_s is None or monotonic() < until_s):
                    helper.join(_POLL_S)  # the last step writes files, which must stay open meanwhile
        if self._failed is not None:
            raise self._failed[1]

    def _help(self, ended: SimpleQueue[None]) -> None:
        """Run steps in this thread, without numpy's warnings as in ``one_thread``: that setting is per thread."""
        try:
            with np.errstate(all="ignore"):
                self._work()
        except BaseException as error:  # not of a step, for example out of memory while passing on a result
            with self._changed:
                self._failed, self._is_stopped = (_BEFORE_ALL, error), True
                self._changed.notify_all()
        finally:
            ended.put(None)

    def _work(self) -> None:
        """Run steps until none is left."""
        while (taken := self._take()) is not None:
            step, number, item = taken
            try:
                result = self._steps[step](item)
            except BaseException as error:
                self._fail(step, number, error)
            else:
                self._pass_on(step, number, result)

    def _take(self) -> tuple[int, int, Any] | None:
        """The next step that can start, with the number of its item and the item; None at the end."""
        with self._changed:
            while (step := self._next_step()) is None:
                if self._is_stopped or not any(self._busy):
                    return None
                self._changed.wait()
            self._busy[step] = True
            self._in_progress += step == 0
            return step, *self._waiting[step].popleft()

    def _next_step(self) -> int | None:
        """The last step that can start, so that few items are in progress."""
        last_first = reversed(range(len(self._steps)))
        return None if self._is_stopped else next(filter(self._can_start, last_first), None)

    def _can_start(self, step: int) -> bool:
        if self._busy[step] or not self._waiting[step]:
            return False
        number, _ = self._waiting[step][0]
        is_needed = self._failed is None or number < self._failed[0]
        return is_needed and (step > 0 or self._in_progress < self._threads + _SPARE)

    def _fail(self, step: int, number: int, error: BaseException) -> None:
        with self._changed:
            self._busy[step] = False
            if self._failed is None or number < self._failed[0]:
                self._failed = number, error
            self._changed.notify_all()

    def _pass_on(self, step: int, number: int, result: Any) -> None:
        """Pass the result to the next step; after the first step, let the next item start."""
        with self._changed:
            self._busy[step] = False
            if result is not _END and step == 0:
                self._waiting[0].append((number + 1, None))
            if result is _END or step + 1 == len(self._steps):
                self._in_progress -= 1
            else:
                self._waiting[step + 1].append((number, result))
            self._changed.notify_all()


def _has_ended(ended: SimpleQueue[None]) -> bool:
    try:
        ended.get(timeout=_WAKES_EVERY_S)
    except Empty:
        return False
    return True
