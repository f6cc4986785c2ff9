"""Several files as one log: their messages in the order of their log times, each file open only while it is read.

A message that several files hold counts once.
"""

import heapq
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from pathlib import Path

from roadperc_stream.config import LimitsConfig
from roadperc_stream.log.audit import in_file_order
from roadperc_stream.log.damage import damaged
from roadperc_stream.log.index import MOST_HELD_BYTES
from roadperc_stream.log.records import RECOVERY_RECORD, Attachment, Channel, LogSummary, Message, Metadata
from roadperc_stream.log.repair import Recovery
from roadperc_stream.log.repeats import Numbered, SharedTimes, Span, marked, shared_times
from roadperc_stream.log.sorting import SortedMessages

Translation = Mapping[int, Channel]
"""The channels of the log by the ``source_id`` that they have in a file."""
Part = tuple[LogSummary, Translation]
"""A file with messages, and its channels."""


@dataclass(frozen=True)
class MergedParts:
    """The messages of files that begin one after the other."""

    parts: Sequence[Part]
    """By their first log time."""

    def numbered(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Numbered]:
        """As ``reading.read``; of equal log times those of the part that begins first come first."""

        def opened(number: int) -> Iterator[Message]:
            summary, translation = self.parts[number]
            return _translated(summary.path, summary.source.messages(topics, start_ns, end_ns), translation)

        waiting = [i for i, (summary, _) in enumerate(self.parts) if _may_hold(summary, topics, start_ns, end_ns)]
        waiting.reverse()
        heap: list[tuple[int, int, Message, Iterator[Message]]] = []  # by log time, then by place in the log
        while waiting or heap:
            if waiting and (not heap or (self.parts[waiting[-1]][0].first_ns or 0) < heap[0][0]):
                number = waiting.pop()
                rest = opened(number)
            else:
                _, number, message, rest = heapq.heappop(heap)
                yield number, message
            if (following := next(rest, None)) is not None:
                heapq.heappush(heap, (following.log_time_ns, number, following, rest))


class SortedParts:
    """The messages of files that are read one after the other and sorted on disk.

    Args:
        name: of the log, for errors.
        parts: by their first log time.
        limits: of their records and chunks.
    """

    def __init__(self, name: str, parts: Sequence[Part], limits: LimitsConfig) -> None:
        self._origins = [(number, channel) for number, (_, known) in enumerate(parts) for channel in known.values()]
        ids = iter(range(len(self._origins)))
        marked_parts = [(file, {i: replace(known[i], source_id=next(ids)) for i in known}) for file, known in parts]
        self._sorted = SortedMessages(name, partial(_in_file_order, marked_parts, limits))

    def numbered(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Numbered]:
        """As ``MergedParts.numbered``.

        Raises:
            TargetError: there is no space to sort them.
        """
        for message in self._sorted.messages(topics, start_ns, end_ns):
            number, channel = self._origins[message.channel.source_id]
            yield number, replace(message, channel=channel)


@dataclass(frozen=True)
class UnitedParts:
    """The messages of several files; what several of them hold comes once."""

    parts: MergedParts | SortedParts
    shared: SharedTimes
    in_turn: Sequence[LogSummary] = ()
    """The files, where one behind the other they are the log: channels with its ids, no message twice; else none."""

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """As ``reading.read``."""
        found = marked(self.parts.numbered(topics, start_ns, end_ns), self.shared)
        return (message for _, message, is_repeated in found if not is_repeated)

    def repeats(self) -> Counter[tuple[int, int]]:
        """How many messages come no second time, by the number of the file and the channel of the log.

        Raises:
            LogError: a file is damaged.
            TargetError: there is no space to sort the messages.
        """
        counts = Counter[tuple[int, int]]()
        for first_ns, last_ns in self.shared.all_spans:
            found = marked(self.parts.numbered(set(self.shared.spans), first_ns, last_ns + 1), self.shared)
            counts.update((number, m.channel.source_id) for number, m, is_repeated in found if is_repeated)
        return counts


def _may_hold(summary: LogSummary, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> bool:
    early = start_ns is not None and (summary.last_ns or 0) < start_ns
    late = end_ns is not None and (summary.first_ns or 0) >= end_ns
    wanted = topics is None or any(c.topic in topics and summary.counts.get(c.source_id) for c in summary.channels)
    return wanted and not early and not late


def _translated(path: Path, messages: Iterable[Message], translation: Translation) -> Iterator[Message]:
    """The messages of a file on the channels of the log.

    Raises:
        LogError: a message is of a channel that the file's summary does not name.
    """
    for message in messages:
        channel = translation.get(message.channel.source_id)
        if channel is None:
            raise damaged(path, f"damaged MCAP: its summary does not name channel {message.channel.source_id}")
        yield replace(message, channel=channel)


def united(files: Sequence[LogSummary], held_bytes: float, limits: LimitsConfig) -> LogSummary:
    """Files as one log: in the order of their times, equal channels of several files as one.

    Args:
        files: of the log.
        held_bytes: the most in memory at a time where they are merged.
        limits: of their records and chunks.
    """
    ordered = sorted(files, key=lambda file: _span_ns(file) or (0, 0))
    attachments = dict[tuple[str, str, bytes], Attachment]()
    for attachment in chain.from_iterable(file.attachments for file in ordered):
        attachments.setdefault((attachment.name, attachment.media_type, attachment.data), attachment)
    metadata = dict.fromkeys(chain.from_iterable(_with_ends(file, ordered) for file in ordered))
    ordered = [replace(file, attachments=(), metadata=()) for file in ordered]
    translations = _translations(ordered)
    if has_own_ids := _ids_agree(ordered, translations):
        translations = [{i: replace(known[i], source_id=i) for i in known} for known in translations]
    holding = [(file, known) for file, known in zip(ordered, translations, strict=True) if _span_ns(file)]
    spans = [span for file, _ in holding if (span := _span_ns(file))]
    name = Path(f"{ordered[0].path} and {len(files) - 1} more")
    shared = shared_times(file for file, _ in holding)
    is_in_turn = has_own_ids and not shared.spans and all(a[1] <= b[0] for a, b in pairwise(spans))
    is_little = held_bytes <= MOST_HELD_BYTES
    parts = MergedParts(holding) if is_little else SortedParts(str(name), holding, limits)
    source = UnitedParts(parts, shared, [file for file, _ in holding] if is_in_turn else [])
    repeats = source.repeats()
    repeats_of = Counter[Path]()
    for (number, _), count in repeats.items():
        repeats_of[holding[number][0].path] += count
    return LogSummary(
        path=name,
        source=source,
        profile=next((file.profile for file in ordered if file.profile), ""),
        channels=tuple(dict.fromkeys(channel for known in translations for channel in known.values())),
        counts=_counts(ordered, translations, repeats),
        attachments=tuple(attachments.values()),
        metadata=tuple(metadata),
        first_ns=min((first for first, _ in spans), default=None),
        last_ns=max((last for _, last in spans), default=None),
        parts=tuple(replace(file, repeats=repeats_of[file.path]) for file in ordered),
        schema_ids=dict(chain.from_iterable(file.schema_ids.items() for file in ordered if is_in_turn)),
    )


def gone_on_ns(summary: LogSummary, files: Iterable[LogSummary]) -> int | None:
    """The log time at which later files hold again all that a file holds: what it lost at its end ends there.

    Args:
        summary: of the file.
        files: of the log.

    Returns:
        None where one of its topics does not come again; what has a single message need not, if others have more.
    """
    first_ns, counts = summary.first_ns or 0, counted_topics(summary)
    repeated = [topic for topic, messages in counts.items() if messages > 1] or list(counts)
    later = [(f.first_ns, counted_topics(f)) for f in files if f.first_ns is not None and f.first_ns > first_ns]
    begins = [min((begin_ns for begin_ns, topics in later if topic in topics), default=None) for topic in repeated]
    known = [ns for ns in begins if ns is not None]
    return max(known) if known and len(known) == len(begins) else None


def counted_topics(summary: LogSummary) -> Counter[str]:
    """Messages by topic, of those that have some."""
    counts = Counter[str]()
    for channel in summary.channels:
        counts[channel.topic] += summary.counts.get(channel.source_id, 0)
    return +counts


def _with_ends(summary: LogSummary, files: Iterable[LogSummary]) -> Iterator[Metadata]:
    """A file's metadata; of one that was repaired, with the ends of its gaps that the other files show."""
    recovery = Recovery.of_records(summary.metadata)
    for record in summary.metadata:
        if recovery is None or record.name != RECOVERY_RECORD:
            yield record
    if recovery is not None:
        yield recovery.ending(gone_on_ns(summary, files)).to_record()


def _translations(summaries: Sequence[LogSummary]) -> list[Translation]:
    """Each file's channels on those of the log: twins within a file stay apart, equal ones of several files do not."""
    known: dict[tuple[Channel, int], Channel] = {}
    made: list[Translation] = []
    for summary in summaries:
        twins, translation = Counter[Channel](), dict[int, Channel]()
        for channel in summary.channels:
            kind = replace(channel, source_id=0)
            translation[channel.source_id] = known.setdefault(
                (kind, twins[kind]), replace(kind, source_id=len(known) + 1)
            )
            twins[kind] += 1
        made.append(translation)
    return made


def _ids_agree(summaries: Sequence[LogSummary], translations: Iterable[Translation]) -> bool:
    """Whether an id means the same channel in all files, or the same schema, and each channel has one id."""
    channels = {(number, common.source_id) for known in translations for number, common in known.items()}
    schemas = {(s.schema_ids[c.source_id], *c.schema) for s in summaries for c in s.channels if s.schema_ids}
    own = {(number, schema_id) for summary in summaries for number, schema_id in summary.schema_ids.items()}
    one_channel = len({number for number, _ in channels}) == len({common for _, common in channels}) == len(channels)
    return one_channel and all(len({pair[0] for pair in pairs}) == len(pairs) for pairs in (schemas, own))


def _counts(
    summaries: Iterable[LogSummary], translations: Iterable[Translation], repeats: Mapping[tuple[int, int], int]
) -> dict[int, int]:
    counts = Counter[int]()
    for summary, translation in zip(summaries, translations, strict=True):
        for source_id, common in translation.items():
            counts[common.source_id] += summary.counts.get(source_id, 0)
    for (_, common_id), number in repeats.items():
        counts[common_id] -= number
    return dict(counts)


def _span_ns(file: LogSummary) -> Span | None:
    """First and last log time; None without messages."""
    if file.first_ns is None or file.last_ns is None or not any(file.counts.values()):
        return None
    return file.first_ns, file.last_ns


def _in_file_order(parts: Iterable[Part], limits: LimitsConfig) -> Iterator[Message]:
    for file, translation in parts:
        yield from _translated(file.path, in_file_order(file.path, limits), translation)
