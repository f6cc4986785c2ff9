"""Notes on one pass over a log: gaps between its files, segments, and messages that belong to no frame."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final

from roadperc_stream.config import SyncConfig
from roadperc_stream.input.stream import Stamped
from roadperc_stream.input.sync import SyncedMessages
from roadperc_stream.log import Attachment, LogSummary, Metadata, counted_topics
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT, METADATA_RECORD
from roadperc_stream.system.time import ns_to_seconds

_MOST_NAMED: Final = 5
_GAP_INTERVALS: Final = 1.5
"""A longer pause between two files is a gap, in intervals of the reference sensor: a frame is missing."""
_OF_EACH_RESULT: Final = {CONFIG_ATTACHMENT, METADATA_RECORD}
"""Records that every result writes for itself."""


@dataclass
class InputOutcome:
    """Counts frames, segments and dropped messages during a pass.

    Args:
        begun_segment: the segment at the beginning.
    """

    begun_segment: int = 0
    frames: int = 0
    """Written frames."""
    given_again: int = 0
    """Written frames that the previous part also has."""
    segment_frames: Counter[int] = field(default_factory=Counter)
    """Written frames of each segment."""
    segment_stamps_ns: dict[int, int] = field(default_factory=dict)
    """The first stamp of each segment."""
    paired: set[str] = field(default_factory=set)
    """Roles with a message in at least one frame."""
    dropped: Counter[str] = field(default_factory=Counter)
    """Messages of each role that belong to no frame."""
    dropped_stamps_ns: dict[str, int] = field(default_factory=dict)
    """The stamp of the first such message."""

    def add(self, synced: SyncedMessages, *, is_written: bool = True) -> None:
        """Count a frame."""
        reference = synced.reference
        self.paired.update(synced.parts)
        if is_written:
            self.frames += 1
            self.given_again += reference.carried is not None
            self.segment_frames[reference.segment] += 1
            self.segment_stamps_ns.setdefault(reference.segment, reference.stamp_ns)

    def drop(self, item: Stamped) -> None:
        """Count a message that belongs to no frame."""
        self.dropped[item.role] += 1
        self.dropped_stamps_ns.setdefault(item.role, item.stamp_ns)

    def notes(self, topics: Mapping[str, str], cfg: SyncConfig, nearest_ns: Mapping[str, int]) -> Iterator[str]:
        """Notes for the user.

        Args:
            topics: the topic of each role.
            cfg: gives the tolerance of stamps within a frame.
            nearest_ns: smallest distance of each role's dropped messages to a frame.
        """
        if self.given_again:
            yield f"{self.given_again} of {self.frames} frames are also in the previous part"
        if max(self.segment_frames, default=0) > self.begun_segment:
            yield self._segments_in_words()
        if self.dropped:
            yield f"messages that belong to no frame: {'; '.join(self._dropped_in_words(topics))}"
        for role in self.dropped:
            if role in nearest_ns and role not in self.paired:
                yield _never_near(topics[role], cfg.tolerance_s, nearest_ns[role])

    def _segments_in_words(self) -> str:
        found = [
            f"{number} from stamp {self.segment_stamps_ns[number]} ns, {frames} frames"
            for number, frames in islice(self.segment_frames.items(), _MOST_NAMED)
        ]
        more = len(self.segment_frames) - len(found)
        named = "; ".join(found + [f"and {more} more"] * (more > 0))
        return f"{len(self.segment_frames)} segments, the state is reset in each: {named}"

    def _dropped_in_words(self, topics: Mapping[str, str]) -> Iterator[str]:
        """Numbers, topics and first stamps; topics with the same number and stamp are grouped."""
        groups: dict[tuple[int, int], list[str]] = {}
        for role, messages in self.dropped.items():
            groups.setdefault((messages, self.dropped_stamps_ns[role]), []).append(topics[role])
        for (messages, stamp_ns), names in groups.items():
            stamp = f"{'the first with ' if messages > 1 else ''}stamp {stamp_ns} ns"
            yield f"{messages} on {'each of ' if len(names) > 1 else ''}{', '.join(names)}, {stamp}"


def _never_near(topic: str, tolerance_s: float, nearest_ns: int) -> str:
    off = f"{ns_to_seconds(nearest_ns):.9f}".rstrip("0").rstrip(".")
    return f"{topic}: in no frame; the nearest message is {off} s from one, sync.tolerance_s is {tolerance_s:g}"


@dataclass(frozen=True)
class PartSpan:
    """First and last log time of a part's messages, and the number that make frames.

    ``repeats`` is the number of messages that an earlier part also has; None if unknown.
    """

    name: str
    first_ns: int
    last_ns: int
    frames: int
    repeats: int | None = None


def part_notes(summary: LogSummary, topic: str) -> tuple[str, ...]:
    """Notes on gaps, overlaps and differences between the files of a log; empty for a single file.

    Args:
        summary: of the log.
        topic: the reference sensor's topic.
    """
    spans = [
        PartSpan(str(part.path), part.first_ns, part.last_ns, counted_topics(part)[topic], part.repeats)
        for part in summary.parts
        if part.first_ns is not None and part.last_ns is not None and any(part.counts.values())
    ]
    joined = [text for text in joins(spans) if text]
    more = (f"{len(joined) - _MOST_NAMED} more parts leave gaps or overlap",) if len(joined) > _MOST_NAMED else ()
    differing = (*_differing("attachment", summary.attachments), *_differing("metadata", summary.metadata))
    return (*joined[:_MOST_NAMED], *more, *(differing if summary.parts else ()))


def joins(parts: Sequence[PartSpan]) -> list[str]:
    """A text for each part that has a gap or overlap to earlier parts, else an empty one.

    Args:
        parts: sorted by first log time.
    """
    least_gap_ns = _GAP_INTERVALS * _interval_ns(parts)
    latest: PartSpan | None = None
    texts = []
    for part in parts:
        texts.append("" if latest is None else _join(latest, part, least_gap_ns))
        latest = part if latest is None or part.last_ns > latest.last_ns else latest
    return texts


def continuation_notes(part: PartSpan, frames_before_ns: Sequence[int], ended_ns: int) -> tuple[str, ...]:
    """A note if there is a gap between a part and the result that it continues.

    Args:
        part: this part.
        frames_before_ns: known log times of the reference sensor's last messages in the previous part.
        ended_ns: log time where the previous part ended.
    """
    before = PartSpan("the continued result", min(frames_before_ns, default=ended_ns), ended_ns, len(frames_before_ns))
    gap_ns, interval_ns = part.first_ns - ended_ns, _interval_ns([before, part])
    missing = interval_ns and gap_ns > _GAP_INTERVALS * interval_ns
    return (_join(before, part, 0.0),) if missing else ()


def _join(before: PartSpan, part: PartSpan, least_gap_ns: float) -> str:
    gap_ns = part.first_ns - before.last_ns
    if gap_ns < 0:
        overlap_s = ns_to_seconds(min(-gap_ns, part.last_ns - part.first_ns))
        return f"{part.name}: overlaps {before.name} by {overlap_s:.3f} s{_shared(part)}"
    if part.repeats:
        return f"{part.name}: begins when {before.name} ends{_shared(part)}"
    if gap_ns > least_gap_ns:
        return f"{part.name}: begins {ns_to_seconds(gap_ns):.3f} s after {before.name} ends"
    return ""


def _shared(part: PartSpan) -> str:
    """The treatment of a part's messages that overlap others."""
    if part.repeats is None:
        return ""
    if not part.repeats:
        return "; they share no message and are merged"
    return f"; {part.repeats} of its messages are also in earlier parts and count once"


def _interval_ns(parts: Iterable[PartSpan]) -> float:
    """Mean interval of the messages that make frames, within the parts."""
    counted = [part for part in parts if part.frames > 1]
    intervals = sum(part.frames - 1 for part in counted)
    return sum(part.last_ns - part.first_ns for part in counted) / intervals if intervals else 0.0


def _differing(kind: str, records: Iterable[Attachment | Metadata]) -> tuple[str, ...]:
    """Notes on records with the same name and different contents."""
    counts: Counter[str] = Counter(record.name for record in records if record.name not in _OF_EACH_RESULT)
    return tuple(f"{kind} {name}: {n} versions in the parts; all are kept" for name, n in counts.items() if n > 1)
