"""Repairs a damaged log: writes what can be read to a new log, with a record of what was lost."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import Final

import msgspec

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.log.damage import nothing_saved
from roadperc_stream.log.records import RECOVERY_RECORD, Metadata
from roadperc_stream.log.salvage import Salvage
from roadperc_stream.log.sorting import in_order_within
from roadperc_stream.log.stored import Spool, StoredLog, storing
from roadperc_stream.log.writing import LogWriter, StoredLogWriter
from roadperc_stream.system.time import ns_to_seconds

_MOST_HELD_BYTES: Final = 32 * 1024 * 1024
_VERSION: Final = "1"
_GAPS_LISTED: Final = 5
_TOPICS_LISTED: Final = 8
_GAPS: Final = list[tuple[int | None, int | None, dict[str, int]]]


@dataclass(frozen=True)
class LostSpan:
    """First and last log time of lost messages, both included, None if unknown, and their number by topic."""

    first_ns: int | None
    last_ns: int | None
    messages: Mapping[str, int]


@dataclass(frozen=True)
class Recovery:
    """The saved and lost messages of a damaged log."""

    saved: int
    """Number of saved messages."""
    lost: Mapping[str, int]
    """Number of messages by topic, as far as the log shows it."""
    exact: bool
    """Whether the number is exact; otherwise more messages may be lost."""
    gaps: tuple[LostSpan, ...]

    @classmethod
    def of_records(cls, metadata: Iterable[Metadata]) -> "Recovery | None":
        """Return the recovery that a log's records state, all its files together; None if it was never repaired."""
        found = [cls._of_values(dict(record.values)) for record in metadata if record.name == RECOVERY_RECORD]
        total: Recovery | None = None
        for recovery in found:
            if recovery is not None:
                total = recovery.after(total, saved=recovery.saved + (total.saved if total else 0))
        return total

    @classmethod
    def _of_values(cls, values: Mapping[str, str]) -> "Recovery | None":
        if values.get("version") != _VERSION:
            return None
        try:
            gaps = tuple(LostSpan(*gap) for gap in msgspec.json.decode(values["gaps"], type=_GAPS))
            lost = msgspec.json.decode(values["lost"], type=dict[str, int])
            return cls(int(values["saved"]), lost, values["exact"] == "true", gaps)
        except (KeyError, ValueError, RecursionError, msgspec.MsgspecError):
            return None

    def to_record(self) -> Metadata:
        """Return the metadata record that ``of_records`` reads."""
        values = {
            "version": _VERSION,
            "saved": str(self.saved),
            "lost": json.dumps(self.lost),
            "exact": json.dumps(self.exact),
            "gaps": json.dumps([[gap.first_ns, gap.last_ns, dict(gap.messages)] for gap in self.gaps]),
        }
        return Metadata(RECOVERY_RECORD, tuple(values.items()))

    def ending(self, last_ns: int | None) -> "Recovery":
        """Return the recovery with an end for gaps without one, except gaps that begin later."""
        if last_ns is None:
            return self
        return replace(self, gaps=tuple(_ending(gap, last_ns) for gap in self.gaps))

    def of_at_most(self, gaps: int) -> "Recovery":
        """Return the recovery with at most this number of gaps; the last one covers the rest."""
        if len(self.gaps) <= gaps:
            return self
        return replace(self, gaps=(*self.gaps[: gaps - 1], _as_one(self.gaps[gaps - 1 :])))

    def after(self, earlier: "Recovery | None", saved: int) -> "Recovery":
        """Return the recovery with the losses of an earlier repair of this log, or of its previous file."""
        if earlier is None:
            return self
        lost = dict(Counter(earlier.lost) + Counter(self.lost))
        return Recovery(saved, lost, self.exact and earlier.exact, (*earlier.gaps, *self.gaps))

    def lines(self, first_ns: int | None) -> Iterator[str]:
        """Yield one line for all losses, then one for each of the first gaps; seconds count from ``first_ns``."""
        lost = sum(self.lost.values())
        number = f"{lost}" if self.exact else f"at least {lost}" if lost else "an unknown number"
        listed = "" if len(self.gaps) == 1 and self.gaps[0].messages == self.lost else _listed(self.lost)
        yield f"{self.saved} messages saved, {number} lost{listed}"
        for gap in self.gaps[:_GAPS_LISTED]:
            yield f"lost {_between(gap, first_ns)}{_listed(gap.messages)}"
        if len(self.gaps) > _GAPS_LISTED:
            yield f"and {len(self.gaps) - _GAPS_LISTED} more gaps"


def _ending(gap: LostSpan, last_ns: int) -> LostSpan:
    is_open = gap.last_ns is None and (gap.first_ns is None or gap.first_ns <= last_ns)
    return replace(gap, last_ns=last_ns) if is_open else gap


def _as_one(gaps: Sequence[LostSpan]) -> LostSpan:
    firsts, lasts = [gap.first_ns for gap in gaps], [gap.last_ns for gap in gaps]
    messages = Counter[str]()
    for gap in gaps:
        messages.update(gap.messages)
    first_ns = None if None in firsts else min(ns for ns in firsts if ns is not None)
    last_ns = None if None in lasts else max(ns for ns in lasts if ns is not None)
    return LostSpan(first_ns, last_ns, dict(messages))


def _listed(messages: Mapping[str, int]) -> str:
    named = [f"{topic} {number}" for topic, number in list(messages.items())[:_TOPICS_LISTED]]
    more = ["..."] if len(messages) > _TOPICS_LISTED else []
    return f": {', '.join((*named, *more))}" if messages else ""


def _between(gap: LostSpan, first_ns: int | None) -> str:
    ends = ("from", gap.first_ns), ("to", gap.last_ns)
    known = [f"{word} {_at(time_ns, first_ns)}" for word, time_ns in ends if time_ns is not None]
    return " ".join(known) or "at an unknown time"


def _at(time_ns: int, first_ns: int | None) -> str:
    return f"{time_ns} ns" if first_ns is None else f"{ns_to_seconds(time_ns - first_ns):.3f} s ({time_ns} ns)"


def _recovery_of(salvage: Salvage) -> Recovery:
    """Return the recovery of a finished salvage."""
    topics = {number: channel.topic for number, channel in salvage.channels.items()}
    gaps = tuple(LostSpan(gap.first_ns, gap.last_ns, _by_topic(gap.messages, topics)) for gap in salvage.losses.all)
    if salvage.written is not None:
        lost = Counter(salvage.written) - salvage.counts
    else:
        lost = sum((Counter(gap.messages) for gap in salvage.losses.all), Counter(salvage.losses.undescribed))
    is_exact = salvage.written is not None or not any(damage.of_messages for damage in salvage.damages)
    return Recovery(salvage.counts.total(), _by_topic(lost, topics), is_exact, gaps)


def _by_topic(counts: Mapping[int, int], topics: Mapping[int, str]) -> dict[str, int]:
    found = Counter[str]()
    for number in sorted(counts):
        found[topics.get(number, f"channel {number}")] += counts[number]
    return dict(+found)


def write_repaired(source: Path, target: Path, limits: LimitsConfig = DEFAULT_LIMITS) -> tuple[Salvage, Recovery]:
    """Write what can be read of a log to a new one, with index, CRCs, and a record of what was lost.

    The copy of a whole log has no such record. ``limits`` are those of records and chunks of ``source``.

    Returns:
        The finished salvage of ``source``, and the recovery in the record.

    Raises:
        LogError: not one message can be read.
        TargetError: ``target`` cannot be written.
    """
    return _repaired(source, partial(LogWriter, target), limits)


def _repaired(source: Path, writer_of: Callable[[str], LogWriter], limits: LimitsConfig) -> tuple[Salvage, Recovery]:
    """Write what can be read of a log; ``writer_of`` makes a writer for its profile."""
    salvage = Salvage(source, limits=limits)
    found = salvage.messages()
    messages = in_order_within(found, lambda m: m.log_time_ns, lambda m: len(m.data), _MOST_HELD_BYTES)
    first = next(messages, None)
    if first is None:
        raise nothing_saved(source, salvage.damages)
    described = salvage.described
    with writer_of(described.profile) as writer:
        for message in chain((first,), messages):
            writer.write(message)
        for number in sorted(described.channels):
            writer.register(described.channels[number])
        for attachment in described.attachments:
            writer.attach(attachment)
        recovery = _recovery_of(salvage)
        if not salvage.whole:
            recovery = recovery.after(Recovery.of_records(described.metadata), recovery.saved).of_at_most(limits.gaps)
        for metadata in described.metadata:
            if salvage.whole or metadata.name != RECOVERY_RECORD:
                writer.describe(metadata)
        if not salvage.whole:
            writer.describe(recovery.to_record())
    return salvage, recovery


@dataclass(frozen=True)
class RepairedLog:
    """The readable part of a log as a whole log under the same name, and the account of its damage."""

    path: Path
    salvage: Salvage
    recovery: Recovery


def repaired_copy(source: Path, limits: LimitsConfig = DEFAULT_LIMITS) -> RepairedLog:
    """Return the readable part of a log as a whole log in an unnamed temporary file.

    Raises:
        LogError: no message can be read.
        TargetError: there is no space for it.
    """
    with storing(str(source)):
        file = TemporaryFile()  # noqa: SIM115 - the spool closes it
    salvage, recovery = _repaired(source, partial(StoredLogWriter, source, file=file), limits)
    return RepairedLog(StoredLog.of(source, Spool(str(source), file)), salvage, recovery)
