"""What can be read of a damaged log, written to a new one that says itself what was lost."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import Final

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.log.damage import nothing_saved
from roadperc_stream.log.records import RECOVERY_RECORD
from roadperc_stream.log.recovery import LostSpan, Recovery
from roadperc_stream.log.salvage import Salvage
from roadperc_stream.log.sorting import in_order_within
from roadperc_stream.log.stored import Spool, StoredLog, storing
from roadperc_stream.log.writing import LogWriter, StoredLogWriter

_MOST_HELD_BYTES: Final = 32 * 1024 * 1024


def _recovery_of(salvage: Salvage) -> Recovery:
    """What a finished salvage saved and lost."""
    topics = {number: channel.topic for number, channel in salvage.channels.items()}
    gaps = tuple(LostSpan(gap.first_ns, gap.last_ns, _by_topic(gap.messages, topics)) for gap in salvage.gaps)
    if salvage.written is not None:
        lost = Counter(salvage.written) - salvage.counts
    else:
        lost = sum((Counter(gap.messages) for gap in salvage.gaps), Counter(salvage.undescribed))
    is_exact = salvage.written is not None or not any(damage.of_messages for damage in salvage.damages)
    return Recovery(salvage.counts.total(), _by_topic(lost, topics), is_exact, gaps)


def _by_topic(counts: Mapping[int, int], topics: Mapping[int, str]) -> dict[str, int]:
    found = Counter[str]()
    for number in sorted(counts):
        found[topics.get(number, f"channel {number}")] += counts[number]
    return dict(+found)


def write_repaired(source: Path, target: Path, limits: LimitsConfig = DEFAULT_LIMITS) -> tuple[Salvage, Recovery]:
    """Write what can be read of a log to a new one, with an index, CRCs, and a record of what was lost.

    Args:
        source: the damaged log; of a whole one the copy has no such record.
        target: the log to write.
        limits: of the records and chunks of ``source``.

    Returns:
        The finished salvage of ``source``, and what the record says.

    Raises:
        LogError: not one message can be read.
        TargetError: ``target`` cannot be written.
    """
    return _repaired(source, partial(LogWriter, target), limits)


def _repaired(source: Path, writer_of: Callable[[str], LogWriter], limits: LimitsConfig) -> tuple[Salvage, Recovery]:
    """Write what can be read of a log; ``writer_of`` makes the writer of its profile."""
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
    """What can be read of a log, as a whole log under the same name, and how it was found."""

    path: Path
    salvage: Salvage
    recovery: Recovery


def repaired_copy(source: Path, limits: LimitsConfig = DEFAULT_LIMITS) -> RepairedLog:
    """What can be read of a log, as a whole log that is stored in a temporary file without a name.

    Raises:
        LogError: not one message can be read.
        TargetError: there is no space for it.
    """
    with storing(str(source)):
        file = TemporaryFile()  # noqa: SIM115 - the spool closes it
    salvage, recovery = _repaired(source, partial(StoredLogWriter, source, file=file), limits)
    return RepairedLog(StoredLog.of(source, Spool(str(source), file)), salvage, recovery)
