"""What is counted of a channel while its messages pass: how often they come, and what is odd about their times."""

from array import array
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float
from roadperc_stream.core.time import NS_PER_S
from roadperc_stream.info.stamps import StampReader

_MOST_KEPT: Final = 65_536
"""Intervals kept of a channel; of more, every second, every fourth and so on."""


@dataclass
class Intervals:
    """Times between messages: all of the first ones, then evenly thinned, so that memory is bounded."""

    _kept: "array[int]" = field(default_factory=lambda: array("Q"))
    _stride: int = 1
    _seen: int = 0

    def add(self, interval_ns: int) -> None:
        """Take one more; log times are 64 bits without a sign, and so are the times between them."""
        if self._seen % self._stride == 0:
            self._kept.append(interval_ns)
        self._seen += 1
        if len(self._kept) == _MOST_KEPT:
            self._kept, self._stride = self._kept[::2], self._stride * 2

    def quantile_s(self, share: float) -> float | None:
        """An interval that this share of all does not exceed; None where there is none."""
        return float(np.quantile(self._seconds(), share)) if self._kept else None

    def jitter_s(self) -> float | None:
        """Difference from the median that 95 % do not exceed; None where there are not two to differ."""
        if len(self._kept) < 2:
            return None
        seconds = self._seconds()
        return float(np.quantile(np.abs(seconds - np.median(seconds)), 0.95))

    def _seconds(self) -> Float:
        """(N,) the kept ones."""
        return np.asarray(self._kept, np.float64) / NS_PER_S


@dataclass
class Tally:
    """The times of one channel's messages, in the order of the file."""

    read_stamp: StampReader | None
    messages: int = 0
    size_bytes: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    intervals: Intervals = field(default_factory=Intervals)
    longest_gap_ns: int = 0
    gap_after_ns: int | None = None
    """Log time of the message before the longest gap."""
    log_times_back: int = 0
    stamps_back: int = 0
    first_back_ns: int | None = None
    """Log time of the first message whose own stamp lies before its forerunner's."""
    stamps_repeated: int = 0
    stamps_unset: int = 0
    """Messages of a schema with a stamp that have none, or one of zero."""
    _last_stamp_ns: int | None = None

    def add(self, log_time_ns: int, data: bytes) -> None:
        """Count one more message."""
        if self.messages:
            self._interval(log_time_ns)
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        self.last_ns = max(self.last_ns, log_time_ns)
        self.messages += 1
        self.size_bytes += len(data)
        if self.read_stamp is not None:
            self._stamp(self.read_stamp(data), log_time_ns)

    def _interval(self, log_time_ns: int) -> None:
        interval_ns = log_time_ns - self.last_ns
        if interval_ns < 0:
            self.log_times_back += 1
            return
        self.intervals.add(interval_ns)
        if interval_ns > self.longest_gap_ns:
            self.longest_gap_ns, self.gap_after_ns = interval_ns, self.last_ns

    def _stamp(self, stamp_ns: int | None, log_time_ns: int) -> None:
        if stamp_ns is None:
            self.stamps_unset += 1
            return
        if self._last_stamp_ns is not None:
            self.stamps_repeated += stamp_ns == self._last_stamp_ns
            if stamp_ns < self._last_stamp_ns:
                self.stamps_back += 1
                self.first_back_ns = log_time_ns if self.first_back_ns is None else self.first_back_ns
        self._last_stamp_ns = stamp_ns
