"""Values of a long replay in bounded memory, and their median and deviation."""

from collections.abc import Sequence
from statistics import median
from typing import Final, Generic, TypeVar

T = TypeVar("T")
_KEPT: Final = 512
_NORMAL_MAD: Final = 1.4826


class Spread(Generic[T]):
    """All values of a short replay, every second one of a longer one, and so on; ``count`` is that of all values."""

    def __init__(self) -> None:
        self.values: list[T] = []
        self.count, self._every = 0, 1

    def add(self, value: T) -> None:
        """Add the next value."""
        if self.count % self._every == 0:
            self.values.append(value)
        self.count += 1
        if len(self.values) > _KEPT:
            self.values, self._every = self.values[::2], self._every * 2


def spread_of(values: Sequence[float]) -> tuple[float, float]:
    """Median and standard deviation of numbers, the latter from their median absolute deviation."""
    middle = median(values)
    return middle, _NORMAL_MAD * median(abs(value - middle) for value in values)
