"""Notes on the frames during which the camera was frozen."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from roadperc_stream.model import Reason
from roadperc_stream.schemas.columns import FrameMetrics

_FROZEN: Final = str(Reason("odometry", "image_frozen"))
_FEWEST_REPEATS: Final = 4
"""A note names runs of five or more equal images; the first one is not frozen yet."""
_MOST_NAMED: Final = 5


@dataclass
class FrozenFrames:
    """The runs of written frames with a frozen image: number and stamp of the first and the last frame of each."""

    _run: tuple[int, int, int, int] | None = None
    _named: list[str] = field(default_factory=list)
    _more: int = 0

    def add(self, row: FrameMetrics) -> None:
        """Take the row of the next frame."""
        if _FROZEN in row.reasons:
            first = (row.frame, row.stamp_ns) if self._run is None else self._run[:2]
            self._run = (*first, row.frame, row.stamp_ns)
        else:
            self._end_run()

    def notes(self) -> Iterator[str]:
        """A note on the long runs until now, if there are any."""
        self._end_run()
        if self._named:
            frames = ", ".join(self._named) + f" and {self._more} more times" * (self._more > 0)
            yield f"frozen camera: the image repeats while other sensors change, odometry is null: frames {frames}"

    def _end_run(self) -> None:
        if self._run is None:
            return
        first, first_ns, last, last_ns = self._run
        self._run = None
        if last - first + 1 < _FEWEST_REPEATS:
            return
        if len(self._named) < _MOST_NAMED:
            self._named.append(f"{first} to {last} (stamps {first_ns} to {last_ns} ns)")
        else:
            self._more += 1
