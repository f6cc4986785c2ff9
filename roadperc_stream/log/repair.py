"""Repairs a damaged log: writes what can be read to a new log, with a record of what was lost."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Final

import msgspec

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.log.damage import LostSpan, nothing_saved
from roadperc_stream.log.records import RECOVERY_RECORD, Metadata
from roadperc_stream.log.recovery import Salvage
from roadperc_stream.log.sorting import in_order_within
from roadperc_stream.log.stored import AnyLog, LogFile, storing
from roadperc_stream.log.writing import LogWriter

_MOST_HELD_BYTES: Final = 32 * 1024 * 1024
_VERSION: Final = "2"
_GAPS_LISTED: Final = 5
_GAPS: Final = list[tuple[int | None, int | None]]


@dataclass(frozen=True)
class Recovery:
    """The number of messages saved of a damaged log, and the times of the lost ones."""

    saved: int
    gaps: tuple[LostSpan, ...] = ()

    @classmethod
    def of_records(cls, metadata: Iterable[Metadata]) -> "Recovery | None":
        """Return the recovery that a log's records state, all its files together; None if it was never repaired."""
        records = (cls._of_values(dict(record.values)) for record in metadata if record.name == RECOVERY_RECORD)
        found = [recovery for recovery in records if recovery is not None]
        if not found:
            return None
        return cls(sum(item.saved for item in found), tuple(chain.from_iterable(item.gaps for item in found)))

    @classmethod
    def _of_values(cls, values: dict[str, str]) -> "Recovery | None":
        if values.get("version") != _VERSION:
            return None
        try:
            gaps = tuple(LostSpan(*gap) for gap in msgspec.json.decode(values["gaps"], type=_GAPS))
            return cls(int(values["saved"]), gaps)
        except (KeyError, ValueError, RecursionError, msgspec.MsgspecError):
            return None

    def to_record(self) -> Metadata:
        """Return the metadata record that ``of_records`` reads."""
        gaps = json.dumps([[gap.first_ns, gap.last_ns] for gap in self.gaps])
        return Metadata(RECOVERY_RECORD, (("version", _VERSION), ("saved", str(self.saved)), ("gaps", gaps)))

    def ending(self, last_ns: int | None) -> "Recovery":
        """Return the recovery with an end for gaps without one, except gaps that begin later."""
        return self if last_ns is None else replace(self, gaps=tuple(gap.ending(last_ns) for gap in self.gaps))

    def lines(self, first_ns: int | None) -> Iterator[str]:
        """Yield one line for all losses, then one for each of the first gaps; seconds count from ``first_ns``."""
        yield f"{self.saved} messages saved, {'others are lost' if self.gaps else 'no loss found'}"
        for gap in self.gaps[:_GAPS_LISTED]:
            yield f"lost {gap.words(first_ns)}"
        if len(self.gaps) > _GAPS_LISTED:
            yield f"and {len(self.gaps) - _GAPS_LISTED} more gaps"


def write_repaired(
    source: AnyLog, target: Path, limits: LimitsConfig = DEFAULT_LIMITS, *, file: IO[bytes] | None = None
) -> tuple[Salvage, Recovery]:
    """Write what can be read of a log to a new one, with index, CRCs, and a record of what was lost.

    The copy of a whole log has no such record. ``limits`` are those of records and chunks of ``source``; ``file`` is
    an unnamed one to write to instead of ``target``.

    Returns:
        The finished salvage of ``source``, and the recovery in the record.

    Raises:
        LogError: not one message can be read.
        TargetError: ``target`` cannot be written.
    """
    salvage = Salvage(source, limits=limits)
    found = salvage.messages()
    messages = in_order_within(found, lambda m: m.log_time_ns, lambda m: len(m.data), _MOST_HELD_BYTES)
    first = next(messages, None)
    if first is None:
        raise nothing_saved(salvage.path, salvage.damages)
    described = salvage.described
    with LogWriter(target, described.profile, file=file) as writer:
        for message in chain((first,), messages):
            writer.write(message)
        for number in sorted(described.channels):
            writer.register(described.channels[number])
        for attachment in described.attachments:
            writer.attach(attachment)
        earlier = Recovery.of_records(described.metadata) or Recovery(0)
        recovery = Recovery(salvage.counts.total(), (*earlier.gaps, *salvage.losses.gaps))
        for metadata in described.metadata:
            if salvage.whole or metadata.name != RECOVERY_RECORD:
                writer.describe(metadata)
        if not salvage.whole:
            writer.describe(recovery.to_record())
    return salvage, recovery


@dataclass(frozen=True)
class RepairedLog:
    """The readable part of a log as a whole log under the same name, and the account of its damage."""

    file: LogFile
    salvage: Salvage
    recovery: Recovery


def repaired_copy(source: LogFile, limits: LimitsConfig = DEFAULT_LIMITS) -> RepairedLog:
    """Return the readable part of a log as a whole log in an unnamed temporary file.

    Raises:
        LogError: no message can be read.
        TargetError: there is no space for it.
    """
    with storing(str(source)):
        file = TemporaryFile()  # noqa: SIM115 - the log owns it
    return RepairedLog(LogFile.temporary(source.name, file), *write_repaired(source, source.name, limits, file=file))
