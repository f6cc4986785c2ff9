"""Reads several files as one log, in the order of log times; each file is open only while it is read.

A message in several files counts once: recorders repeat some messages at the start of a file, and files are copied.
Messages are equal if topic, schema, times, sequence and bytes are equal. If one file has a message several times, the
log also does. Only messages of a log time that several files have are compared, by digests.
"""

import heapq
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from itertools import chain, count, pairwise
from pathlib import Path

from roadperc_stream.log.damage import damaged
from roadperc_stream.log.records import RECOVERY_RECORD, Attachment, Channel, LogSummary, Message, Metadata
from roadperc_stream.log.repair import Recovery

Translation = Mapping[int, Channel]
"""The channels of the log, by their ``source_id`` in a file."""
Span = tuple[int, int]
"""First and last log time, both included."""


@dataclass(frozen=True)
class UnitedFiles:
    """Reads the messages of files; a message in several of them is yielded once."""

    files: Sequence[tuple[LogSummary, Translation]]
    """The files with messages, sorted by their first log times, and their channels."""
    in_turn: Sequence[LogSummary] = ()
    """The files, if they can be read one after the other: the log's channel ids, and no common times."""

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """Yield messages as ``reading.read``; among equal log times those of the earlier file come first."""
        return (message for _, message, is_repeated in self._marked(topics, start_ns, end_ns) if not is_repeated)

    def repeats(self) -> Counter[tuple[int, int]]:
        """Count the messages that earlier files have too, by number of the file and channel of the log.

        Raises:
            LogError: a file is damaged.
            TargetError: there is no space to sort the messages.
        """
        topics, counts = self._common_topics(), Counter[tuple[int, int]]()
        for first_ns, last_ns in _overlaps(_span_ns(file) for file, _ in self.files) if topics else ():
            found = self._marked(topics, first_ns, last_ns + 1)
            counts.update((number, m.channel.source_id) for number, m, is_repeated in found if is_repeated)
        return counts

    def _common_topics(self) -> frozenset[str]:
        """Return the topics that several files have."""
        files = Counter(chain.from_iterable(counted_topics(file) for file, _ in self.files))
        return frozenset(topic for topic, number in files.items() if number > 1)

    def _marked(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[int, Message, bool]]:
        """Yield each message with the number of its file, and whether an earlier file has it too."""
        coming = [i for i, (file, _) in enumerate(self.files) if _may_hold(file, topics, start_ns, end_ns)]
        coming.reverse()
        common = self._common_topics()
        heap: list[tuple[int, int, Message, Iterator[Message]]] = []  # by log time, then by file
        known, in_file = Counter[bytes](), Counter[bytes]()  # messages of this log time, in all files and in this one
        now = -1, -1
        while coming or heap:
            if coming and (not heap or (self.files[coming[-1]][0].first_ns or 0) <= heap[0][0]):
                number = coming.pop()
                file, translation = self.files[number]
                rest = _translated(file.path, file.source.messages(topics, start_ns, end_ns), translation)
            else:
                time_ns, number, message, rest = heapq.heappop(heap)
                if time_ns != now[0]:
                    known.clear()
                if now != (time_ns, number):
                    in_file.clear()
                now, is_repeated = (time_ns, number), False
                if message.channel.topic in common and (known or (heap and heap[0][0] == time_ns)):
                    digest = _digest(message)
                    in_file[digest] += 1
                    is_repeated = in_file[digest] <= known[digest]
                    known[digest] += not is_repeated
                yield number, message, is_repeated
            if (following := next(rest, None)) is not None:
                heapq.heappush(heap, (following.log_time_ns, number, following, rest))


def _overlaps(spans: Iterable[Span | None]) -> Iterator[Span]:
    """Yield where spans, sorted by their first times, overlap earlier ones: disjoint and ascending."""
    latest_ns = reached_ns = -1
    for first_ns, last_ns in filter(None, spans):
        begin_ns, end_ns = max(first_ns, reached_ns + 1), min(last_ns, latest_ns)
        if begin_ns <= end_ns:
            yield begin_ns, end_ns
            reached_ns = end_ns
        latest_ns = max(latest_ns, last_ns)


def _digest(message: Message) -> bytes:
    channel = message.channel
    kind = f"{channel.topic}\0{channel.schema_name}\0{channel.message_encoding}"
    found = blake2b(f"{kind}\0{message.publish_time_ns}\0{message.sequence}\0".encode(), digest_size=16)
    found.update(message.data)
    return found.digest()


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


def united(files: Sequence[LogSummary]) -> LogSummary:
    """Return files as one log, in the order of their times; equal channels of several files become one."""
    ordered = sorted(files, key=lambda file: _span_ns(file) or (0, 0))
    attachments = dict[tuple[str, str, bytes], Attachment]()
    for attachment in chain.from_iterable(file.attachments for file in ordered):
        attachments.setdefault((attachment.name, attachment.media_type, attachment.data), attachment)
    metadata = dict.fromkeys(chain.from_iterable(_with_ends(file, ordered) for file in ordered))
    ordered = [replace(file, attachments=(), metadata=()) for file in ordered]
    translations = _translations(ordered)
    holding = [(file, known) for file, known in zip(ordered, translations, strict=True) if _span_ns(file)]
    spans = [span for file, _ in holding if (span := _span_ns(file))]
    is_in_turn = _ids_agree(ordered, translations) and all(a[1] < b[0] for a, b in pairwise(spans))
    source = UnitedFiles(holding, [file for file, _ in holding] if is_in_turn else [])
    channels = dict.fromkeys(channel for known in translations for channel in known.values())
    repeats = source.repeats()
    repeats_of = Counter[Path]()
    for (number, _), repeated in repeats.items():
        repeats_of[holding[number][0].path] += repeated
    return LogSummary(
        path=Path(f"{ordered[0].path} and {len(files) - 1} more"),
        source=source,
        profile=next((file.profile for file in ordered if file.profile), ""),
        channels=tuple(channel if is_in_turn else replace(channel, schema_id=0) for channel in channels),
        counts=_counts(ordered, translations, repeats),
        attachments=tuple(attachments.values()),
        metadata=tuple(metadata),
        first_ns=min((first for first, _ in spans), default=None),
        last_ns=max((last for _, last in spans), default=None),
        files=tuple(replace(file, repeats=repeats_of[file.path]) for file in ordered),
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


def _translations(summaries: Iterable[LogSummary]) -> list[Translation]:
    """Return the channels of each file: equal channels of several files become one, those of one file stay separate.

    A channel keeps its id if no earlier one has it.
    """
    known: dict[tuple[Channel, int], Channel] = {}
    used: set[int] = set()
    made: list[Translation] = []
    for summary in summaries:
        twins, translation = Counter[Channel](), dict[int, Channel]()
        for channel in summary.channels:
            kind = replace(channel, source_id=0)
            key = kind, twins[kind]
            if key not in known:
                number = next(i for i in chain((channel.source_id,), count(1)) if i not in used)
                used.add(number)
                known[key] = replace(channel, source_id=number)
            translation[channel.source_id] = known[key]
            twins[kind] += 1
        made.append(translation)
    return made


def _ids_agree(summaries: Sequence[LogSummary], translations: Iterable[Translation]) -> bool:
    """Return whether the channels and schemas of all files have the ids of the log."""
    pairs = [(c, known[c.source_id]) for s, known in zip(summaries, translations, strict=True) for c in s.channels]
    schemas = {(channel.schema_id, *channel.schema) for channel, _ in pairs}
    have_ids = all((own.source_id, own.schema_id) == (common.source_id, common.schema_id) for own, common in pairs)
    return have_ids and len({schema_id for schema_id, *_ in schemas}) == len(schemas)


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
