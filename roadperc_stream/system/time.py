"""Times: integer nanoseconds in logs, seconds in options and configurations."""

import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Final

from roadperc_stream.errors import ConfigError

NS_PER_S: Final = 1_000_000_000
LONGEST_PAUSE_NS: Final = 3600 * NS_PER_S
"""Longest pause between two frames of a segment; a longer one is a jump of the clock, or another recording."""
END_OF_TIME_NS: Final = 2**63
"""The first stamp beyond the signed 64 bits of tables and viewers."""


def seconds_to_ns(seconds: float) -> int:
    """The nearest whole number of nanoseconds."""
    return round(seconds * NS_PER_S)


def ns_to_seconds(time_ns: float) -> float:
    """Nanoseconds as seconds."""
    return time_ns / NS_PER_S


@dataclass(frozen=True)
class TimeRange:
    """A part of a log: limits in seconds from its first message, and the most frames."""

    start_s: float | None = None
    end_s: float | None = None
    frames: int | None = None

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            ConfigError: a limit is invalid, or the range ends before it starts.
        """
        for name, limit_s in (("start", self.start_s), ("end", self.end_s)):
            if limit_s is not None and not (isinstance(limit_s, Real) and math.isfinite(limit_s)):
                raise ConfigError(f"{name}: expected seconds, found {limit_s!r}")
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            raise ConfigError(f"end {self.end_s:g} s: expected more than the start, {self.start_s:g} s")
        if self.frames is not None and (isinstance(self.frames, bool) or not isinstance(self.frames, Integral)):
            raise ConfigError(f"frames: expected a whole number, found {self.frames!r}")
        if self.frames is not None and self.frames < 1:
            raise ConfigError(f"frames: expected 1 or more, found {self.frames}")


WHOLE: Final = TimeRange()
