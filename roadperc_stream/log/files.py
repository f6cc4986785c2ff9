"""Reads several files as one log, in the order of log times; each file is open only while it is read.

A message in several files counts once: recorders repeat some messages at the start of a file, and files are copied.
Messages are equal if topic, schema, times, sequence and bytes are equal. If one file has a message several times, the
log also does. Only topics and times that files share are compared, with digests of the current log time.
"""

import heapq
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b
from itertools import chain, pairwise
from pathlib import Path

from roadperc_stream.log.damage import damaged
from roadperc_stream.log.index import MOST_HELD_BYTES
from roadperc_stream.log.records import RECOVERY_RECORD, Attachment, Channel, LogSummary, Message, Metadata
from roadperc_stream.log.repair import Recovery
from roadperc_stream.log.sorting import SortedMessages

Translation = Mapping[int, Channel]
"""The channels of the log, by their ``source_id`` in a file."""
File = tuple[LogSummary, Translation]
"""A file with messages, and its channels."""
Span = tuple[int, int]
"""First and last log time, both included."""
Numbered = tuple[int, Message]
"""The number of a file, and a message in it."""


@dataclass(frozen=True)
class MergedFiles:
    """Merges the messages of files, sorted by their first log time."""

    files: Sequence[File]

    def numbered(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Numbered]:
        """Yield messages as ``reading.read``; among equal log times those of the earlier file come first."""

        def opened(number: int) -> Iterator[Message]:
            summary, translation = self.files[number]
            return _translated(summary.path, summary.source.messages(topics, start_ns, end_ns), translation)

        waiting = [i for i, (summary, _) in enumerate(self.files) if _may_hold(summary, topics, start_ns, end_ns)]
        waiting.reverse()
        heap: list[tuple[int, int, Message, Iterator[Message]]] = []  # by log time, then by file
        while waiting or heap:
            if waiting and (not heap or (self.files[waiting[-1]][0].first_ns or 0) < heap[0][0]):
                number = waiting.pop()
                rest = opened(number)
            else:
                _, number, message, rest = heapq.heappop(heap)
                yield number, message
            if (following := next(rest, None)) is not None:
                heapq.heappush(heap, (following.log_time_ns, number, following, rest))


class SortedFiles:
    """Reads files one after the other and sorts their messages on disk.

    Args:
        name: the log, for errors.
        files: sorted by their first log time.
    """

    def __init__(self, name: str, files: Sequence[File]) -> None:
        self._origins = [(number, channel) for number, (_, known) in enumerate(files) for channel in known.values()]
        ids = iter(range(len(self._origins)))
        distinct = [(file, {i: replace(known[i], source_id=next(ids)) for i in known}) for file, known in files]
        self._sorted = SortedMessages(name, partial(_in_file_order, distinct))

    def numbered(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Numbered]:
        """Yield messages as ``MergedFiles.numbered``.

        Raises:
            TargetError: there is no space to sort them.
        """
        for message in self._sorted.messages(topics, start_ns, end_ns):
            number, channel = self._origins[message.channel.source_id]
            yield number, replace(message, channel=channel)


@dataclass(frozen=True)
class SharedTimes:
    """The times at which several files have messages on one topic: disjoint ascending spans, by topic."""

    spans: Mapping[str, Sequence[Span]]

    @classmethod
    def of(cls, files: Iterable[LogSummary]) -> "SharedTimes":
        """Return the times that files share; the files are sorted by their first log times."""
        spans: dict[str, list[Span]] = {}
        for file in files:
            for topic in counted_topics(file):
                spans.setdefault(topic, []).append((file.first_ns or 0, file.last_ns or 0))
        found = {topic: _disjoint(_overlaps(of_topic)) for topic, of_topic in spans.items()}
        return cls({topic: overlaps for topic, overlaps in found.items() if overlaps})

    def hold(self, message: Message) -> bool:
        """Return whether another file may hold an equal message."""
        spans = self.spans.get(message.channel.topic, ())
        place = bisect_right(spans, message.log_time_ns, key=lambda span: span[0]) - 1
        return place >= 0 and message.log_time_ns <= spans[place][1]

    @property
    def all_spans(self) -> list[Span]:
        """The spans of any topic, disjoint and ascending."""
        return _disjoint(sorted(span for spans in self.spans.values() for span in spans))

    def marked(self, messages: Iterable[Numbered]) -> Iterator[tuple[int, Message, bool]]:
        """Yield each message with the number of its file, and whether an earlier file holds it too.

        ``messages`` are sorted by log time; those of equal time are sorted by file.
        """
        now: tuple[int, int] | None = None  # log time and file of the last message that was compared
        found, in_file = Counter[bytes](), Counter[bytes]()
        for number, message in messages:
            is_repeated = False
            if self.hold(message):
                if now is None or now[0] != message.log_time_ns:
                    found.clear()
                if now != (message.log_time_ns, number):
                    in_file.clear()
                now, digest = (message.log_time_ns, number), _digest(message)
                in_file[digest] += 1
                is_repeated = in_file[digest] <= found[digest]
                found[digest] += not is_repeated
            yield number, message, is_repeated


def _overlaps(spans: Iterable[Span]) -> Iterator[Span]:
    """Yield where a span overlaps earlier ones; the spans are sorted by their first times."""
    latest_ns = -1
    for first_ns, last_ns in spans:
        if first_ns <= latest_ns:
            yield first_ns, min(last_ns, latest_ns)
        latest_ns = max(latest_ns, last_ns)


def _disjoint(spans: Iterable[Span]) -> list[Span]:
    """Return sorted spans with overlapping ones joined."""
    joined: list[Span] = []
    for first_ns, last_ns in spans:
        if joined and first_ns <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], last_ns)
        else:
            joined.append((first_ns, last_ns))
    return joined


def _digest(message: Message) -> bytes:
    channel = message.channel
    kind = f"{channel.topic}\0{channel.schema_name}\0{channel.message_encoding}"
    found = blake2b(f"{kind}\0{message.publish_time_ns}\0{message.sequence}\0".encode(), digest_size=16)
    found.update(message.data)
    return found.digest()


@dataclass(frozen=True)
class UnitedFiles:
    """Reads the messages of several files; a message in several of them is yielded once."""

    files: MergedFiles | SortedFiles
    shared: SharedTimes
    in_turn: Sequence[LogSummary] = ()
    """The files, if they can be read one after the other: the log's channel ids, and no shared times."""

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """Yield messages as ``reading.read``."""
        found = self.shared.marked(self.files.numbered(topics, start_ns, end_ns))
        return (message for _, message, is_repeated in found if not is_repeated)

    def repeats(self) -> Counter[tuple[int, int]]:
        """Count the messages that earlier files hold too, by number of the file and channel of the log.

        Raises:
            LogError: a file is damaged.
            TargetError: there is no space to sort the messages.
        """
        counts = Counter[tuple[int, int]]()
        for first_ns, last_ns in self.shared.all_spans:
            found = self.shared.marked(self.files.numbered(set(self.shared.spans), first_ns, last_ns + 1))
            counts.update((number, m.channel.source_id) for number, m, is_repeated in found if is_repeated)
        return counts


def _may_hold(summary: LogSummary, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> bool:
    early = start_ns is not None and (summary.last_ns or 0) < start_ns
    late = end_ns is not None and (summary.first_ns or 0) >= end_ns
    return not (early or late) and (topics is None or not counted_topics(summary).keys().isdisjoint(topics))


def _translated(path: Path, messages: Iterable[Message], translation: Translation) -> Iterator[Message]:
    """Yield the messages of a file on the channels of the log.

    Raises:
        LogError: the file's summary does not name a message's channel.
    """
    for message in messages:
        channel = translation.get(message.channel.source_id)
        if channel is None:
            raise damaged(path, f"damaged MCAP: its summary does not name channel {message.channel.source_id}")
        yield replace(message, channel=channel)


def united(files: Sequence[LogSummary], held_bytes: float) -> LogSummary:
    """Return files as one log, in the order of their times; equal channels of several files become one.

    ``held_bytes`` is the most memory that merging takes.
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
    shared = SharedTimes.of(file for file, _ in holding)
    is_in_turn = has_own_ids and not shared.spans and all(a[1] <= b[0] for a, b in pairwise(spans))
    is_little = held_bytes <= MOST_HELD_BYTES
    combined = MergedFiles(holding) if is_little else SortedFiles(str(name), holding)
    source = UnitedFiles(combined, shared, [file for file, _ in holding] if is_in_turn else [])
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
        files=tuple(replace(file, repeats=repeats_of[file.path]) for file in ordered),
        schema_ids=dict(chain.from_iterable(file.schema_ids.items() for file in ordered if is_in_turn)),
    )


def gone_on_ns(summary: LogSummary, files: Iterable[LogSummary]) -> int | None:
    """Return the log time from which later files continue all topics of a file; its losses at the end stop there.

    None if a topic does not continue. Topics with one message are not required to, unless all topics have only one.
    """
    first_ns, counts = summary.first_ns or 0, counted_topics(summary)
    repeated = [topic for topic, messages in counts.items() if messages > 1] or list(counts)
    later = [(f.first_ns, counted_topics(f)) for f in files if f.first_ns is not None and f.first_ns > first_ns]
    begins = [min((begin_ns for begin_ns, topics in later if topic in topics), default=None) for topic in repeated]
    known = [ns for ns in begins if ns is not None]
    return max(known) if known and len(known) == len(begins) else None


def counted_topics(summary: LogSummary) -> Counter[str]:
    """Return the number of messages of each topic with messages."""
    counts = Counter[str]()
    for channel in summary.channels:
        counts[channel.topic] += summary.counts.get(channel.source_id, 0)
    return +counts


def _with_ends(summary: LogSummary, files: Iterable[LogSummary]) -> Iterator[Metadata]:
    """Yield a file's metadata; other files show where the gaps of a repaired file end."""
    recovery = Recovery.of_records(summary.metadata)
    for record in summary.metadata:
        if recovery is None or record.name != RECOVERY_RECORD:
            yield record
    if recovery is not None:
        yield recovery.ending(gone_on_ns(summary, files)).to_record()


def _translations(summaries: Sequence[LogSummary]) -> list[Translation]:
    """Return the channels of each file: equal channels of several files become one, those of one file stay separate."""
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
    """Return whether an id means the same channel or schema in all files, and each channel has one id."""
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
    """Return first and last log time; None without messages."""
    if file.first_ns is None or file.last_ns is None or not any(file.counts.values()):
        return None
    return file.first_ns, file.last_ns


def _in_file_order(files: Iterable[File]) -> Iterator[Message]:
    for file, translation in files:
        yield from _translated(file.path, file.source.messages(None, None, None), translation)
