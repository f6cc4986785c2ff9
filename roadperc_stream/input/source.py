"""The log and time range to replay, how a damaged log is read, and the frames' reasons for lost messages."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from math import inf
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.config import LimitsConfig
from roadperc_stream.log import Damage, DamagedLogError, LogFile, LogSummary, LostSpan, Recovery, RepairedLog
from roadperc_stream.model import Reason
from roadperc_stream.system.time import WHOLE, TimeRange, ns_to_seconds

SOURCE = "log"
"""Source of the reasons for lost messages."""


class LossTimes:
    """Finds by bisection when messages were lost: a log may have many gaps, and every frame is looked up."""

    def __init__(self, gaps: Iterable[LostSpan]) -> None:
        """Sort the gaps of the log."""
        spans = sorted((_or(g.first_ns, -inf), _or(g.last_ns, inf)) for g in gaps)
        self._firsts = [first for first, _ in spans]
        self._latest = list(accumulate((last for _, last in spans), max))
        """For each gap, the latest end of all gaps up to it: ascending."""

    def reason(self, since_ns: int | None, until_ns: int) -> Reason | None:
        """Return the reason if messages were lost since the previous frame; None if none were lost.

        Args:
            since_ns: log time of the previous frame; None for the first one.
            until_ns: log time of the frame; for an incomplete one, the latest log time of its missing messages.
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
    """A log that can be replayed: the whole log, or what could be read of a damaged one.

    ``error`` is the damage, None for a whole log. ``damaged`` are the repaired files. ``first_ns`` is the log time of
    the first message written.
    """

    summary: LogSummary
    error: DamagedLogError | None = None
    damaged: tuple[RepairedLog, ...] = ()
    first_ns: int | None = None

    def part(self, asked: TimeRange) -> TimeRange:
        """Return the requested range relative to the first message that could be read."""
        first_ns, saved_ns = self.first_ns, self.summary.first_ns
        if self.error is None or first_ns is None or saved_ns is None or saved_ns <= first_ns:
            return asked
        by_s = ns_to_seconds(saved_ns - first_ns)
        start_s = None if asked.start_s is None else asked.start_s - by_s
        return TimeRange(start_s, None if asked.end_s is None else asked.end_s - by_s, asked.frames)

    def require_outside(self, start_ns: int | None, end_ns: int | None) -> None:
        """Check that no message from ``start_ns`` up to ``end_ns`` may be damaged; None is no limit.

        Raises:
            LogError: one may be.
        """
        if self.error and any(d.concerns(start_ns, end_ns) for copy in self.damaged for d in copy.salvage.damages):
            raise self.error

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the damaged files."""
        found = ((copy.file.name, copy.salvage.damages, copy.recovery) for copy in self.damaged)
        return tuple(text for facts in found for text in warnings_of(*facts, self.first_ns))


def _repaired(file: LogFile, limits: LimitsConfig, error: DamagedLogError) -> RepairedLog | None:
    """Return the repaired copy of a file; None if it is whole. ``error`` names the first damaged file."""
    is_whole = file.name != error.path and log.audited(file, limits).whole
    return None if is_whole else log.repaired_copy(file, limits)


def _in_log(copy: RepairedLog, files: Sequence[LogSummary]) -> RepairedLog:
    """Return a repaired file whose losses end where later files continue."""
    own = next((file for file in files if file.path == copy.file.name), None)
    return copy if own is None else replace(copy, recovery=copy.recovery.ending(log.gone_on_ns(own, files)))


def warnings_of(source: Path, damages: Sequence[Damage], recovery: Recovery, first_ns: int | None) -> Iterator[str]:
    """Yield warnings about a damaged log: where it is damaged, what was saved and what was lost."""
    yield f"{source}: {log.first_damage(damages)}"
    yield from recovery.lines(first_ns)


@dataclass(frozen=True)
class ReplaySource:
    """The log to replay, and how to read it.

    Args:
        paths: the log, or its files; ``-`` is standard input.
        overrides: topic by role, for roles on other topics than the contract's.
        time_range: the range to replay; it also cuts the copy of the input.
        recover: replay what can be read of a damaged log; frames behind losses have a reason.
        strict: stop with an error at the first unusable message, instead of skipping it.
    """

    paths: Path | Sequence[Path]
    overrides: Mapping[str, str] = field(default_factory=dict)
    time_range: TimeRange = WHOLE
    recover: bool = False
    strict: bool = False

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the log."""
        return (self.paths,) if isinstance(self.paths, Path) else tuple(self.paths)

    def read(self, limits: LimitsConfig) -> ReadableLog:
        """Open the log; with ``recover`` or a time range, a damaged log is repaired into a temporary file.

        Raises:
            LogError: it cannot be read, or is damaged and neither applies.
            TargetError: there is no space for temporary files.
        """
        sources = log.received(self.files)
        despite_damage = self.recover or self.time_range != WHOLE
        try:
            return ReadableLog(log.summarise(sources, limits))
        except DamagedLogError as error:
            if not despite_damage:
                raise
            copies = [_repaired(file, limits, error) for file in sources]
            files = [copy.file if copy else file for copy, file in zip(copies, sources, strict=True)]
            summary = log.summarise(files, limits)
            damaged = tuple(_in_log(copy, summary.files) for copy in copies if copy is not None)
            firsts = (summary.first_ns, *(copy.salvage.first_ns for copy in damaged))
            first_ns = min((ns for ns in firsts if ns is not None), default=None)
            return ReadableLog(summary, error, damaged, first_ns)
