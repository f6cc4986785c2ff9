"""Messages that several files of one log hold: recorders repeat some where a file begins, and files are copied.

Of messages that are equal in topic, schema, times, sequence and bytes each file's own number counts, and of several
files the largest: what one file holds twice stays twice. Compared are only messages on topics that several files have,
within the time that these files share; in memory are a digest of each of the current log time, and no bytes.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b

from roadperc_stream.log.records import LogSummary, Message

Span = tuple[int, int]
"""First and last log time, both included."""
Numbered = tuple[int, Message]
"""The number of a file, and a message in it."""


@dataclass(frozen=True)
class SharedTimes:
    """When several files have messages on one topic: disjoint spans in their order, by topic."""

    spans: Mapping[str, Sequence[Span]]

    def hold(self, message: Message) -> bool:
        """Whether another file may hold an equal message."""
        spans = self.spans.get(message.channel.topic, ())
        place = bisect_right(spans, message.log_time_ns, key=lambda span: span[0]) - 1
        return place >= 0 and message.log_time_ns <= spans[place][1]

    @property
    def all_spans(self) -> list[Span]:
        """The spans of any topic, disjoint and in their order."""
        return _disjoint(sorted(span for spans in self.spans.values() for span in spans))


def shared_times(files: Iterable[LogSummary]) -> SharedTimes:
    """When files with messages share a topic.

    Args:
        files: by their first log times.
    """
    spans: dict[str, list[Span]] = {}
    for file in files:
        for topic in {channel.topic for channel in file.channels if file.counts.get(channel.source_id)}:
            spans.setdefault(topic, []).append((file.first_ns or 0, file.last_ns or 0))
    found = {topic: _disjoint(_overlaps(of_topic)) for topic, of_topic in spans.items()}
    return SharedTimes({topic: overlaps for topic, overlaps in found.items() if overlaps})


def _overlaps(spans: Iterable[Span]) -> Iterator[Span]:
    """Where a span meets those before it.

    Args:
        spans: by their first times.
    """
    latest_ns = -1
    for first_ns, last_ns in spans:
        if first_ns <= latest_ns:
            yield first_ns, min(last_ns, latest_ns)
        latest_ns = max(latest_ns, last_ns)


def _disjoint(spans: Iterable[Span]) -> list[Span]:
    """Spans that are given by their first times, those that meet as one."""
    joined: list[Span] = []
    for first_ns, last_ns in spans:
        if joined and first_ns <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], last_ns)
        else:
            joined.append((first_ns, last_ns))
    return joined


def marked(messages: Iterable[Numbered], shared: SharedTimes) -> Iterator[tuple[int, Message, bool]]:
    """The messages, each with the number of its file and whether a file before holds it as well.

    Args:
        messages: by log time, those of equal time file by file.
        shared: when messages can be equal.
    """
    now: tuple[int, int] | None = None  # log time and number of the file of the last message that can be equal
    given, in_file = Counter[bytes](), Counter[bytes]()
    for number, message in messages:
        is_repeated = False
        if shared.hold(message):
            if now is None or now[0] != message.log_time_ns:
                given.clear()
            if now != (message.log_time_ns, number):
                in_file.clear()
            now, digest = (message.log_time_ns, number), _digest(message)
            in_file[digest] += 1
            is_repeated = in_file[digest] <= given[digest]
            given[digest] += not is_repeated
        yield number, message, is_repeated


def _digest(message: Message) -> bytes:
    channel = message.channel
    kind = f"{channel.topic}\0{channel.schema_name}\0{channel.message_encoding}"
    found = blake2b(f"{kind}\0{message.publish_time_ns}\0{message.sequence}\0".encode(), digest_size=16)
    found.update(message.data)
    return found.digest()
