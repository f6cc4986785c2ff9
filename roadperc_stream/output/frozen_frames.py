"""Notes on the frames during which the camera was frozen."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from roadperc_stream.model import Reason
from roadperc_stream.schemas.columns import FrameMetrics

_FROZEN: Final = Reason("odometry", "image_frozen")
_FEWEST_REPEATS: Final = 4
"""A note names runs of five or more equal images; the first one is not frozen yet."""
_MOST_NAMED: Final = 5


@dataclass
class FrozenFrames:
    """The runs of written frames with a frozen image: number and stamp of the first and the last frame of each."""

    _runs: list[list[tuple[int, int]]] = field(default_factory=list)
    _more: int = 0
    _is_frozen: bool = False

    def add(self, row: FrameMetrics) -> None:
        """Take the row of the next frame."""
        here, was_frozen, self._is_frozen = (row.frame, row.stamp_ns), self._is_frozen, _FROZEN in row.reasons
        if self._is_frozen and was_frozen:
            self._runs[-1][1] = here
        elif self._is_frozen:
            runs = self._long()
            self._more += len(runs) > _MOST_NAMED
            self._runs = [*runs[:_MOST_NAMED], [here, here]]

    def notes(self) -> Iterator[str]:
        """A note on the long runs until now, if there are any."""
        if runs := self._long():
            named = [f"{a} to {b} (stamps {a_ns} to {b_ns} ns)" for (a, a_ns), (b, b_ns) in runs[:_MOST_NAMED]]
            more = self._more + len(runs) - len(named)
            frames = ", ".join(named) + f" and {more} more times" * (more > 0)
            yield f"frozen camera: the image repeats while other sensors change, odometry is null: frames {frames}"

    def _long(self) -> list[list[tuple[int, int]]]:
        return [run for run in self._runs if run[1][0] - run[0][0] + 1 >= _FEWEST_REPEATS]
