"""The random numbers of one corruption of one message."""

from dataclasses import dataclass
from zlib import crc32

import numpy as np

from roadperc_stream.geometry import Camera


@dataclass(frozen=True)
class Draw:
    """Where a message is in its log, and generators that depend on nothing else.

    ``share`` is the message's place in time, from the log's begin (0) to its end (1), ``cameras`` are those of the log.
    """

    seed: int
    name: str
    stamp_ns: int
    role: str
    share: float
    cameras: tuple[Camera, ...]

    @property
    def of_log(self) -> np.random.Generator:
        """A new generator, equal for all messages."""
        return np.random.default_rng(self._key)

    @property
    def of_frame(self) -> np.random.Generator:
        """A new generator, equal for all messages with this stamp."""
        return np.random.default_rng((*self._key, self.stamp_ns))

    @property
    def of_message(self) -> np.random.Generator:
        """A new generator of this message."""
        return np.random.default_rng((*self._key, self.stamp_ns, crc32(self.role.encode())))

    @property
    def _key(self) -> tuple[int, int]:
        return self.seed, crc32(self.name.encode())
