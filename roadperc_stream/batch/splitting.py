"""A long log as parts that are replayed at once: where each of them begins and ends.

Every part but the first begins before the one before it ends, so that some frames are in both: by those ``joining``
knows how the one goes on from the other. How many there are in a stretch of time only the log says, for frames come at
any rate and some were dropped; so the log is looked at where it is cut, and nowhere else.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import NS_PER_S, WHOLE, TimeRange, ns_to_seconds, seconds_to_ns
from roadperc_stream.errors import ConfigError
from roadperc_stream.input.replay_input import ReplayInput

LEAST_SHARED: Final = 3
"""Frames that a part has in common with the one before at least: one whose pose is known in both, and one to either
side of it."""
_LAST_PART: Final = 0.5
"""Of the length of a part: what is left at the log's end and shorter than this belongs to the part before."""
_FIRST_LOOK_NS: Final = NS_PER_S
_FARTHER: Final = 4
"""How far back before a cut is looked for frames at first, and how many times as far after too few were found."""

FrameTimes = Callable[[int, int], Sequence[int]]
"""Log times of the messages that make frames, ascending: from a log time up to another one, which is not included."""


@dataclass(frozen=True)
class SplitPart:
    """A part of a log, in seconds from the log's first message; None where the log itself begins or ends.

    ``shared_frames`` is how many messages that make frames it has in common with the part before.
    """

    index: int
    start_s: float | None
    end_s: float | None
    shared_frames: int = 0

    @property
    def time_range(self) -> TimeRange:
        """What of the log a replay of it is asked for."""
        return TimeRange(self.start_s, self.end_s)

    def warm_up_s(self, asked_s: float) -> float:
        """The warm-up of its replay: none where the log begins, for nothing is before that."""
        return 0.0 if self.start_s is None else asked_s


def require_split(split_s: float, overlap_s: float) -> None:
    """Check that parts would be longer than what they have in common.

    Raises:
        ConfigError: they would not.
    """
    if not split_s > overlap_s:
        raise ConfigError(f"--split {split_s:g}: expected more than {overlap_s:g} s, which parts have in common")


def overlap_s_of(cfg: ReplayConfig) -> float:
    """What parts have in common at least: twice as long as a frame's messages may be late."""
    return 2 * cfg.sync.max_wait_s


def parts_of(
    span_ns: tuple[int, int], split_s: float, frame_times: FrameTimes, overlap_s: float, asked: TimeRange = WHOLE
) -> tuple[SplitPart, ...]:
    """Cut a log every ``split_s`` seconds.

    The last part is between half a length and one and a half long. A part begins ``overlap_s`` before the one before
    ends, or as much earlier as it takes to have ``LEAST_SHARED`` frames in common with it; where the log holds fewer
    since the cut before, it is not cut there.

    Args:
        span_ns: first and last log time of the log.
        split_s: length of a part in seconds, without what it has in common with the one before.
        frame_times: looks into the log.
        overlap_s: twice as long as a frame's messages may be late, so that in the middle nothing is missing.
        asked: the part of the log that is to be replayed at all.

    Raises:
        ConfigError: parts would be no longer than what they have in common, or a number of frames is asked for.
    """
    require_split(split_s, overlap_s)
    if asked.frames is not None:
        raise ConfigError(f"frames {asked.frames}: not together with a split, whose parts are times")
    first_ns, last_ns = span_ns
    begin_ns = first_ns + seconds_to_ns(asked.start_s or 0.0)
    end_ns = last_ns if asked.end_s is None else min(last_ns, first_ns + seconds_to_ns(asked.end_s))
    cuts_ns = _cuts_ns(begin_ns, end_ns, seconds_to_ns(split_s))
    seams = tuple(_seams(begin_ns, cuts_ns, frame_times, seconds_to_ns(overlap_s)))
    starts = ((asked.start_s, 0), *((ns_to_seconds(s.start_ns - first_ns), s.frames) for s in seams))
    ends_s = (*(ns_to_seconds(seam.cut_ns - first_ns) for seam in seams), asked.end_s)
    return tuple(SplitPart(k, start, end, n) for k, ((start, n), end) in enumerate(zip(starts, ends_s, strict=True)))


def parts_of_log(
    log_in: ReplayInput, cfg: ReplayConfig, split_s: float, asked: TimeRange = WHOLE
) -> tuple[SplitPart, ...]:
    """The parts of a log that was opened as a whole, for ``asked``; of its messages only those near a cut are read.

    Raises:
        ConfigError: as ``parts_of``.
        LogError: the log cannot be read.
    """
    summary, topic = log_in.summary, log_in.topics[log_in.plan.order.reference]

    def frame_times(start_ns: int, end_ns: int) -> list[int]:
        return [m.log_time_ns for m in log.read(summary, topics=[topic], start_ns=start_ns, end_ns=end_ns)]

    span_ns = summary.first_ns or 0, summary.last_ns or 0
    return parts_of(span_ns, split_s, frame_times, overlap_s_of(cfg), asked)


@dataclass(frozen=True)
class _Seam:
    """A cut, where the part behind it begins, and the frames in between, which the part before has too."""

    cut_ns: int
    start_ns: int
    frames: int


def _cuts_ns(begin_ns: int, end_ns: int, split_ns: int) -> range:
    return range(begin_ns + split_ns, end_ns - int(_LAST_PART * split_ns) + 1, split_ns)


def _seams(begin_ns: int, cuts_ns: Iterable[int], frame_times: FrameTimes, overlap_ns: int) -> Iterator[_Seam]:
    """Those of the cuts before which there are enough frames."""
    since_ns = begin_ns
    for cut_ns in cuts_ns:
        seam = _seam(since_ns, cut_ns, frame_times, overlap_ns)
        if seam is not None and seam.start_ns > since_ns:
            yield seam
            since_ns = seam.start_ns


def _seam(since_ns: int, cut_ns: int, frame_times: FrameTimes, overlap_ns: int) -> _Seam | None:
    """The seam at a cut; None where there are too few frames since the part before begins."""
    reach_ns, found_ns = max(overlap_ns, _FIRST_LOOK_NS), cut_ns
    while found_ns > since_ns:
        found_ns = max(cut_ns - reach_ns, since_ns)
        times_ns = frame_times(found_ns, cut_ns)
        if len(times_ns) >= LEAST_SHARED:
            start_ns = min(times_ns[-LEAST_SHARED], cut_ns - overlap_ns)
            return _Seam(cut_ns, start_ns, sum(time_ns >= start_ns for time_ns in times_ns))
        reach_ns *= _FARTHER
    return None
