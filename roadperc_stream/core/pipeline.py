"""A job over many items in up to three threads: what is ahead of the caller, the caller, and what is behind it.

Everything comes in the order of the items, errors too: so what is made does not depend on how many threads there are,
nor on which of them is faster.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from types import TracebackType
from typing import Final, Self, TypeVar

import numpy as np

T = TypeVar("T")
_DEPTH: Final = 2
"""Items made ahead, and tasks left behind, at most: a spare one while the other is worked on."""


class Pipeline:
    """Use it as a context manager: no thread outlives it.

    Args:
        threads: 1: everything is done in the caller's; 2: items are made ahead, and tasks done behind, in a second one;
            3 or more: each of both has its own.
    """

    def __init__(self, threads: int) -> None:
        self._ahead = _worker() if threads > 1 else None
        self._behind = _worker() if threads > 2 else self._ahead
        self._tasks = deque[Future[object]]()
        self._has_failed = False

    def ahead(self, items: Iterator[T]) -> Iterator[T]:
        """The items of an iterator; its error comes where it stands among them."""
        if self._ahead is None:
            yield from items
            return
        made = deque(self._ahead.submit(_next, items) for _ in range(_DEPTH))
        while found := made.popleft().result():
            made.append(self._ahead.submit(_next, items))
            yield from found

    def behind(self, task: Callable[[], object]) -> None:
        """Do one more task, after those before it.

        Raises:
            Exception: an earlier task's, or this one's; none is begun after it.
        """
        if self._behind is None:
            task()
            return
        while len(self._tasks) >= _DEPTH:
            self._tasks.popleft().result()
        self._tasks.append(self._behind.submit(self._done, task))

    def _done(self, task: Callable[[], object]) -> None:
        if self._has_failed:
            return
        try:
            task()
        except BaseException:
            self._has_failed = True
            raise

    def _finish(self) -> None:
        while self._tasks:
            self._tasks.popleft().result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None or issubclass(kind, Exception):  # an earlier item's error comes first, as in one thread
                self._finish()
        finally:
            for worker in filter(None, (self._ahead, self._behind)):
                worker.shutdown(cancel_futures=True)


def _worker() -> ThreadPoolExecutor:
    """A thread in which numpy is as silent as in ``one_thread``: that setting is a thread's own."""
    return ThreadPoolExecutor(1, "roadperc", partial(np.seterr, all="ignore"))


def _next(items: Iterator[T]) -> tuple[T, ...]:
    """One more item; none at the end."""
    for item in items:
        return (item,)
    return ()
