"""Which part of which log is to be replayed, what of a damaged log can be, and what its frames say of lost messages."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from math import inf
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.config import LimitsConfig
from roadperc_stream.log import Damage, DamagedLogError, LogSummary, LostSpan, Recovery, RepairedLog
from roadperc_stream.model import Reason
from roadperc_stream.system.time import WHOLE, TimeRange, ns_to_seconds

SOURCE = "log"
"""Whose reason it is that messages were lost."""


class LossTimes:
    """When messages were lost, found by bisection: a log may have many gaps, and each frame asks."""

    def __init__(self, gaps: Iterable[LostSpan]) -> None:
        """Sort the gaps of the log."""
        spans = sorted((_or(g.first_ns, -inf), _or(g.last_ns, inf)) for g in gaps)
        self._firsts = [first for first, _ in spans]
        self._latest = list(accumulate((last for _, last in spans), max))
        """Of each gap and those that begin before it, the end that is last: it never falls."""

    def reason(self, since_ns: int | None, until_ns: int) -> Reason | None:
        """That messages were lost since the frame before, or at this one; None if all are there.

        Args:
            since_ns: log time of the frame before; None of the first one, which speaks for all that was lost before it.
            until_ns: log time of the frame; of one that lacks messages, up to which they may have come.
        """
        begun = bisect_right(self._firsts, until_ns)
        over = 0 if since_ns is None else bisect_right(self._latest, since_ns)
        if over >= begun:
            return None
        first_ns, last_ns = self._firsts[over], self._latest[begun - 1]
        match first_ns > -inf, last_ns < inf:
            case False, False:
                return Reason(SOURCE, "lost_to_damage_somewhere")
            case False, True:
                return Reason(SOURCE, "lost_to_damage_before", (last_ns,))
            case True, False:
                return Reason(SOURCE, "lost_to_damage_after", (first_ns,))
        return Reason(SOURCE, "lost_to_damage", (first_ns, last_ns))


def _or(time_ns: int | None, otherwise: float) -> float:
    return otherwise if time_ns is None else time_ns


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
        first_ns, saved_ns = self.first_ns, self.summary.first_ns
        if self.error is None or first_ns is None or saved_ns is None or saved_ns <= first_ns:
            return asked
        by_s = ns_to_seconds(saved_ns - first_ns)
        start_s = None if asked.start_s is None else asked.start_s - by_s
        return TimeRange(start_s, None if asked.end_s is None else asked.end_s - by_s, asked.frames)

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


@dataclass(frozen=True)
class ReplaySource:
    """What is to be replayed.

    Args:
        paths: the log, or its parts; ``-`` is standard input.
        overrides: topic of each role that is not on the contract's topic.
        time_range: the part to replay; the copy of the input is cut with it.
        recover: replay what can be read of a damaged log; frames behind what was lost say so.
        strict: the first message that cannot be used is an error, instead of costing that message alone.
    """

    paths: Path | Sequence[Path]
    overrides: Mapping[str, str] = field(default_factory=dict)
    time_range: TimeRange = WHOLE
    recover: bool = False
    strict: bool = False

    @property
    def files(self) -> tuple[Path, ...]:
        """The log's parts, one of a log that is not in parts."""
        return (self.paths,) if isinstance(self.paths, Path) else tuple(self.paths)

    def read(self, limits: LimitsConfig) -> ReadableLog:
        """The log, or what can be read of it with ``recover``, or where only some of it is to be replayed.

        Args:
            limits: of its records and chunks.

        Raises:
            LogError: it cannot be read, or is damaged where that is an error.
            TargetError: there is no space for temporary files, where it needs some.
        """
        sources = log.received(self.files)
        despite_damage = self.recover or self.time_range != WHOLE
        try:
            return ReadableLog(log.summarise(sources, limits, check_chunks=despite_damage))
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
