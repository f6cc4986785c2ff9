"""A damaged log as the input of a replay: what of it can be replayed, and what its frames say of what was lost."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from math import inf
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.core.config import LimitsConfig
from roadperc_stream.core.datatypes import Reason
from roadperc_stream.core.reasons import UNUSABLE
from roadperc_stream.core.time import WHOLE, TimeRange, ns_to_seconds
from roadperc_stream.errors import LogError
from roadperc_stream.log import Damage, DamagedLogError, LogSummary, LostSpan, Recovery, RepairedLog

SOURCE = "log"
"""Whose reason it is that messages were lost."""


def reach_ns(since_ns: int | None, log_time_ns: int, late_ns: int) -> int:
    """The log time up to which what a frame lacks may have come: late ones, and those up to the next frame.

    Args:
        since_ns: log time of the frame before, None of the first one: the next frame is as far away.
        log_time_ns: of the frame.
        late_ns: by how much messages of the log are late.
    """
    return log_time_ns + late_ns + (0 if since_ns is None else log_time_ns - since_ns)


class LossTimes:
    """When messages were lost, found by bisection: a log may have many gaps, and each frame asks."""

    def __init__(self, gaps: Iterable[LostSpan]) -> None:
        """Sort the gaps of the log."""
        spans = sorted((-inf if g.first_ns is None else g.first_ns, _end(g)) for g in gaps)
        self._firsts = [first for first, _ in spans]
        self._latest = list(accumulate((last for _, last in spans), max))
        """Of each gap and those that begin before it, the end that is last: it never falls."""

    def reason(self, since_ns: int | None, until_ns: int) -> Reason | None:
        """That messages were lost since the frame before, or at this one; None where none were.

        Args:
            since_ns: log time of the frame before; None of the first one, which speaks for all that was lost before it.
            until_ns: log time of the frame; of one that lacks messages, up to which they may have come.
        """
        begun = bisect_right(self._firsts, until_ns)
        over = 0 if since_ns is None else bisect_right(self._latest, since_ns)
        return _reason(self._firsts[over], self._latest[begun - 1]) if over < begun else None


def _end(gap: LostSpan) -> float:
    return inf if gap.last_ns is None else gap.last_ns


def _reason(first_ns: float, last_ns: float) -> Reason:
    match first_ns > -inf, last_ns < inf:
        case False, False:
            return Reason(SOURCE, "lost_to_damage_somewhere")
        case False, True:
            return Reason(SOURCE, "lost_to_damage_before", (last_ns,))
        case True, False:
            return Reason(SOURCE, "lost_to_damage_after", (first_ns,))
    return Reason(SOURCE, "lost_to_damage", (first_ns, last_ns))


def is_over(gap: LostSpan, since_ns: int | None) -> bool:
    """Whether no frame later than one whose log time is ``since_ns`` (None: of the first one) can lie in a gap."""
    return since_ns is not None and gap.last_ns is not None and gap.last_ns <= since_ns


def ended(gaps: Iterable[LostSpan], next_ns: int | None) -> tuple[LostSpan, ...]:
    """The gaps of a part of a drive, where one without an end ends before the first message of the next part."""
    return tuple(
        replace(gap, last_ns=max(next_ns - 1, gap.first_ns or 0)) if gap.last_ns is None and next_ns else gap
        for gap in gaps
    )


def shifted(part: TimeRange, first_ns: int | None, saved_ns: int | None) -> TimeRange:
    """A part of a log, counted from the first message that was saved of it instead of the first one it had."""
    if first_ns is None or saved_ns is None or saved_ns <= first_ns:
        return part
    by_s = ns_to_seconds(saved_ns - first_ns)
    start_s = None if part.start_s is None else part.start_s - by_s
    return TimeRange(start_s, None if part.end_s is None else part.end_s - by_s, part.frames)


@dataclass(frozen=True)
class ReadableLog:
    """A log that can be replayed: as it stands, or what was saved of it.

    ``error`` says that it is damaged, None where it is whole; ``damaged`` are the files that are, ``first_ns`` the log
    time of the first message there was.
    """

    summary: LogSummary
    error: DamagedLogError | None = None
    damaged: tuple[RepairedLog, ...] = ()
    first_ns: int | None = None

    def part(self, asked: TimeRange) -> TimeRange:
        """What is asked for, counted from the first message that is left."""
        return shifted(asked, self.first_ns, self.summary.first_ns) if self.error else asked

    def require_outside(self, start_ns: int | None, end_ns: int | None) -> None:
        """Check that damage concerns no message from ``start_ns`` up to ``end_ns``, None without a limit.

        Raises:
            LogError: it may.
        """
        if self.error and any(d.concerns(start_ns, end_ns) for copy in self.damaged for d in copy.salvage.damages):
            raise self.error

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of it."""
        found = ((copy.path, copy.salvage.damages, copy.recovery) for copy in self.damaged)
        return tuple(text for facts in found for text in warnings_of(*facts, self.first_ns))


def readable_log(
    paths: Sequence[Path],
    limits: LimitsConfig,
    asked: TimeRange = WHOLE,
    *,
    recover: bool = False,
    is_audited: bool = False,
) -> ReadableLog:
    """A log, or what can be read of it where that is asked for, or where only some of it is to be replayed.

    Args:
        paths: of the log, or of its parts; ``-`` is standard input.
        limits: of its records and chunks.
        asked: the part to replay; damage elsewhere is none of it.
        recover: whether damage is no error.
        is_audited: as ``log.summarise``.

    Raises:
        LogError: it cannot be read, or is damaged.
        TargetError: there is no space for temporary files, where it needs some.
    """
    sources = log.received(paths)
    despite_damage = recover or asked != WHOLE
    try:
        return ReadableLog(log.summarise(sources, limits, check_chunks=despite_damage, is_audited=is_audited))
    except DamagedLogError as error:
        if not despite_damage:
            raise
        copies = [_repaired(path, limits, error) for path in sources]
        files = [copy.path if copy else path for copy, path in zip(copies, sources, strict=True)]
        summary = log.summarise(files, limits)
        damaged = tuple(_in_log(copy, summary.parts) for copy in copies if copy is not None)
        firsts = (summary.first_ns, *(copy.salvage.first_ns for copy in damaged))
        first_ns = min((ns for ns in firsts if ns is not None), default=None)
        return ReadableLog(summary, error, damaged, first_ns)


def _repaired(path: Path, limits: LimitsConfig, error: DamagedLogError) -> RepairedLog | None:
    """The repaired copy of a file, which may be the one that the error is of; None where it is whole."""
    is_whole = path != error.path and log.audited(path, limits, check_chunks=True).whole
    return None if is_whole else log.repaired_copy(path, limits)


def _in_log(copy: RepairedLog, parts: Sequence[LogSummary]) -> RepairedLog:
    """A repaired part, whose losses end where later parts go on."""
    own = next((part for part in parts if part.path == copy.path), None)
    return copy if own is None else replace(copy, recovery=copy.recovery.ending(log.gone_on_ns(own, parts)))


def warnings_of(source: Path, damages: Sequence[Damage], recovery: Recovery, first_ns: int | None) -> Iterator[str]:
    """What the user should know of a log that was damaged: where, what was saved and what was lost."""
    number = log.number_of(damages)
    more = f" (the first of {number} damages)" if number > 1 else ""
    yield f"{source}: damaged at byte {damages[0].byte}: {damages[0].words}{more}"
    yield from recovery.lines(first_ns)


def require_sound(source: Path, stamp_ns: int, reasons: Iterable[Reason]) -> None:
    """Check that no message of a frame is unusable, as ``--strict`` asks for.

    Raises:
        LogError: one is.
    """
    for reason in reasons:
        if reason.code in UNUSABLE:
            raise LogError(f"{source}: message with stamp {stamp_ns} ns: {reason}; --strict stops there")
