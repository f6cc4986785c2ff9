"""Sorting what arrives nearly in order, with little of it in memory."""

import heapq
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")


def in_order_within(
    items: Iterable[T], time_of: Callable[[T], int], size_of: Callable[[T], int], most: int
) -> Iterator[T]:
    """Items by time, those of equal time as they came, as far as holding some of them can tell.

    Args:
        items: in any order.
        time_of: what they are sorted by.
        size_of: what holding one costs.
        most: the sum of sizes from which on the earliest item held is given.
    """
    waiting: list[tuple[int, int, T]] = []
    held = 0
    for number, item in enumerate(items):
        heapq.heappush(waiting, (time_of(item), number, item))
        held += size_of(item)
        while held > most:
            first = heapq.heappop(waiting)[2]
            held -= size_of(first)
            yield first
    while waiting:
        yield heapq.heappop(waiting)[2]
