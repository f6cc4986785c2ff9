"""A class over time: the majority vote of the last frames, so that a single one does not make it flicker."""

from collections import Counter
from dataclasses import dataclass

from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.time import NS_PER_S

MOST_OBSERVED = 256
"""Observations that are kept: half a second at 500 frames per second."""


@dataclass(frozen=True)
class ClassHistory:
    """The classes observed in the window that ends with the last segmented frame: stamps and names, oldest first."""

    observations: tuple[tuple[int, str], ...] = ()

    def add(self, cfg: LanesConfig, stamp_ns: int, name: str) -> "ClassHistory":
        """With one frame's class, and without those older than ``lanes.hold_s``.

        An empty name (out of sight) adds nothing: earlier observations stand until they are too old. While frames have
        no segmentation, nothing is added and the result stays as it is.
        """
        kept = tuple(item for item in self.observations if (stamp_ns - item[0]) / NS_PER_S <= cfg.hold_s)
        return ClassHistory((*kept, (stamp_ns, name))[-MOST_OBSERVED:] if name else kept)

    @property
    def majority(self) -> str:
        """The most frequent class, of equally frequent ones the latest; empty where nothing was observed."""
        counts = Counter(name for _, name in self.observations)
        latest = {name: stamp_ns for stamp_ns, name in self.observations}
        return max(counts, key=lambda name: (counts[name], latest[name]), default="")
