"""Finds the log time of a frame."""

from dataclasses import dataclass
from shlex import quote

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.input.stream import Problems
from roadperc_stream.view.result_frames import read_rows


@dataclass(frozen=True)
class Stop:
    """The frame to open at: its number, the log time of its results, and its stamp."""

    frame: int
    log_time_ns: int
    stamp_ns: int

    @property
    def name(self) -> str:
        """The timeline that ends at this frame."""
        return f"up to frame {self.frame}"


def frame_times(path: log.AnyLog) -> dict[int, Stop]:
    """The times of every frame of a log with results, by its number in the metrics.

    Raises:
        LogError: the log cannot be read.
    """
    rows = read_rows(log.summarise(path), Problems())
    return {row.frame: Stop(row.frame, log_time_ns, row.stamp_ns) for log_time_ns, row in rows}


def find_stop(path: log.AnyLog, frame: int) -> Stop:
    """The stop at a frame of a log with results, by its number in the metrics.

    Raises:
        LogError: the log cannot be read, or has no such frame.
    """
    stops = frame_times(path)
    if frame not in stops:
        without = f"the log has no results; run roadperc-replay {quote(str(path))} OUT.mcap first"
        known = f"expected {min(stops)} to {max(stops)}" if stops else without
        raise LogError(f"{path}: no frame {frame}; {known}")
    return stops[frame]
