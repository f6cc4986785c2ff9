"""The random numbers of one corruption of one message."""

from dataclasses import dataclass
from typing import Literal
from zlib import crc32

import numpy as np

from roadperc_stream.geometry import Camera


@dataclass(frozen=True)
class Draw:
    """A message's place in its log, on which alone its random numbers depend.

    ``share`` is its place in time, from the log's begin (0) to its end (1), ``cameras`` are those of the log.
    """

    seed: int
    name: str
    stamp_ns: int
    role: str
    share: float
    cameras: tuple[Camera, ...]

    def rng(self, scope: Literal["log", "stamp", "message"]) -> np.random.Generator:
        """A new generator, equal for all messages of the log, for those of one stamp, or for this message alone."""
        parts = {"log": (), "stamp": (self.stamp_ns,), "message": (self.stamp_ns, crc32(self.role.encode()))}[scope]
        return np.random.default_rng((self.seed, crc32(self.name.encode()), *parts))
