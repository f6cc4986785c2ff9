"""How long each stage takes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter, thread_time


@dataclass
class StageTimer:
    """Milliseconds each stage took; made for one frame, before its first stage.

    ``clock`` gives seconds: of the wall, or where several threads have a part in the frame those that each of them
    worked (``thread_time``).
    """

    clock: Callable[[], float] = perf_counter
    elapsed_ms: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Begin the frame."""
        self._started = self.clock()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Measure what happens inside, and add it to the stage's time."""
        started = self.clock()
        try:
            yield
        finally:
            self.elapsed_ms[name] = self.elapsed_ms.get(name, 0.0) + (self.clock() - started) * 1000

    def end(self) -> None:
        """End the frame: its ``total`` is the time since it began, or where each thread has its own clock the sum."""
        if self.clock is thread_time:
            self.elapsed_ms["total"] = sum(self.elapsed_ms.values())
        else:
            self.elapsed_ms["total"] = (self.clock() - self._started) * 1000

    def columns(self) -> dict[str, float]:
        """The time columns of a row; stages that did not run are left out."""
        return {f"{name}_ms": value for name, value in self.elapsed_ms.items()}
