"""How long each stage takes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter


@dataclass
class StageTimer:
    """Milliseconds each stage took; made for one frame."""

    elapsed_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Measure what happens inside, and add it to the stage's time."""
        started = perf_counter()
        try:
            yield
        finally:
            self.elapsed_ms[name] = self.elapsed_ms.get(name, 0.0) + (perf_counter() - started) * 1000

    def columns(self) -> dict[str, float]:
        """The time columns of a row; stages that did not run are left out."""
        return {f"{name}_ms": value for name, value in self.elapsed_ms.items()}
