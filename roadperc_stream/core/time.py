"""Times: logs count integer nanoseconds, people and configurations seconds."""

from dataclasses import dataclass
from typing import Final

NS_PER_S: Final = 1_000_000_000
END_OF_TIME_NS: Final = 2**63
"""The first stamp that does not fit the signed 64 bits in which tables and viewers hold one."""


def seconds_to_ns(seconds: float) -> int:
    """The nearest whole number of nanoseconds."""
    return round(seconds * NS_PER_S)


def ns_to_seconds(time_ns: float) -> float:
    """Seconds of nanoseconds."""
    return time_ns / NS_PER_S


@dataclass(frozen=True)
class TimeRange:
    """What part of a log is replayed: seconds from its first message, and at most so many frames."""

    start_s: float | None = None
    end_s: float | None = None
    frames: int | None = None


WHOLE: Final = TimeRange()
