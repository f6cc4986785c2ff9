"""Delta debugging: finds a small part of a failing input that still fails.

The method is ``ddmin`` of Zeller and Hildebrandt, Simplifying and Isolating Failure-Inducing Input, IEEE Transactions
on Software Engineering 28 (2), 2002.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import TypeVar

T = TypeVar("T")


def ddmin(
    items: Sequence[T], fails: Callable[[Sequence[T]], bool], passed: Iterable[Sequence[T]] = (), *, span: bool = False
) -> Sequence[T]:
    """The part of some items that still fails: without any one of its items it passes.

    The paper's monotony holds: the parts of a passing part pass, and are not tested.

    Args:
        items: unique items, which fail together.
        fails: tests a part, in the order of the items.
        passed: parts that are known to pass.
        span: every part is a span of consecutive items; only items at either end can be removed.
    """
    known = [frozenset(part) for part in passed]
    count = 2
    while len(items) > 1:
        for is_subset, part in _parts(items, count, span=span):
            if any(frozenset(part) <= other for other in known):
                continue
            if fails(part):
                items, count = part, 2 if is_subset else max(count - 1, 2)
                break
            known.append(frozenset(part))
        else:
            if count == len(items):
                break
            count = min(2 * count, len(items))
    return items


def _parts(items: Sequence[T], count: int, *, span: bool) -> Iterator[tuple[bool, Sequence[T]]]:
    """Yield ``count`` subsets of about equal size with True, the last one first, then their complements with False."""
    bounds = [len(items) * number // count for number in range(count + 1)]
    pairs = list(pairwise(bounds))
    yield from ((True, items[first:end]) for first, end in reversed(pairs))
    removed = (pairs[0], pairs[-1]) if span else pairs
    yield from ((False, [*items[:first], *items[end:]]) for first, end in removed)
