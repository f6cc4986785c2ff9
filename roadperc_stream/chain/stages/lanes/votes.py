"""A class over time: what most of the last frames saw, so that a single one does not make it flicker."""

from collections import Counter
from dataclasses import dataclass

from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.time import NS_PER_S

_MOST = 256
"""Votes that are kept: half a second at 500 frames per second."""


@dataclass(frozen=True)
class Votes:
    """The classes seen in the window that ends with the last frame that could look: stamps and names, oldest first."""

    cast: tuple[tuple[int, str], ...] = ()

    def add(self, cfg: LanesConfig, stamp_ns: int, name: str) -> "Votes":
        """With one frame's class, and without those older than ``lanes.hold_s``.

        An empty name (out of sight) is no vote: what was seen before stands until it is too old. While no frame can
        look, nothing is added and the result stays as it is.
        """
        kept = tuple(vote for vote in self.cast if (stamp_ns - vote[0]) / NS_PER_S <= cfg.hold_s)
        return Votes((*kept, (stamp_ns, name))[-_MOST:] if name else kept)

    @property
    def winner(self) -> str:
        """The most frequent class, of equally frequent ones that seen last; empty where nothing was seen."""
        counts = Counter(name for _, name in self.cast)
        latest = {name: stamp_ns for stamp_ns, name in self.cast}
        return max(counts, key=lambda name: (counts[name], latest[name]), default="")
