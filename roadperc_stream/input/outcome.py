"""What the user should know of one pass over a log: how its files join, its segments, the messages in no frame."""

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
"""Intervals of the reference sensor from which on a pause between two parts is a gap: a frame is missing there."""
_OF_EACH_RESULT: Final = {CONFIG_ATTACHMENT, METADATA_RECORD}
"""What every result has of its own, and no other result takes over."""


@dataclass
class InputOutcome:
    """What became of the messages so far.

    Args:
        begun_segment: the segment at the beginning.
    """

    begun_segment: int = 0
    frames: int = 0
    """Frames that are written."""
    given_again: int = 0
    """Of these the ones that the part before gave as well."""
    segment_frames: Counter[int] = field(default_factory=Counter)
    """The same by segment."""
    segment_stamps_ns: dict[int, int] = field(default_factory=dict)
    """The stamp that each segment begins with."""
    paired: set[str] = field(default_factory=set)
    """Roles of which some frame has a message."""
    dropped: Counter[str] = field(default_factory=Counter)
    """Messages of each role that belong to no frame."""
    dropped_stamps_ns: dict[str, int] = field(default_factory=dict)
    """The stamp of the first of them."""

    def add(self, synced: SyncedMessages, *, is_written: bool = True) -> None:
        """Take note of a frame."""
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
        """What the user should know of it.

        Args:
            topics: of the roles.
            cfg: how far the stamps of a frame's messages may differ.
            nearest_ns: how near the messages of each role that belong to no frame came to one.
        """
        if self.given_again:
            yield f"{self.given_again} of {self.frames} frames are in the part before as well, and given again"
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
        return f"{len(self.segment_frames)} segments, the stages' memory begins anew in each: {named}"

    def _dropped_in_words(self, topics: Mapping[str, str]) -> Iterator[str]:
        """Numbers, topics and first stamps; topics that agree in the others together."""
        groups: dict[tuple[int, int], list[str]] = {}
        for role, messages in self.dropped.items():
            groups.setdefault((messages, self.dropped_stamps_ns[role]), []).append(topics[role])
        for (messages, stamp_ns), names in groups.items():
            stamp = f"{'the first with ' if messages > 1 else ''}stamp {stamp_ns} ns"
            yield f"{messages} on {'each of ' if len(names) > 1 else ''}{', '.join(names)}, {stamp}"


def _never_near(topic: str, tolerance_s: float, nearest_ns: int) -> str:
    off = f"{ns_to_seconds(nearest_ns):.9f}".rstrip("0").rstrip(".")
    return f"{topic}: in no frame, the nearest message is {off} s from one: sync.tolerance_s is {tolerance_s:g}"


@dataclass(frozen=True)
class PartSpan:
    """When a part's messages begin and end, and how many of them make frames.

    ``repeats`` are those that an earlier part holds as well; None where that is not known.
    """

    name: str
    first_ns: int
    last_ns: int
    frames: int
    repeats: int | None = None


def part_notes(summary: LogSummary, topic: str) -> tuple[str, ...]:
    """What the user should know of how the parts of a log fit together; nothing of a log in one file.

    Args:
        summary: of the log.
        topic: of the reference sensor.
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
    """How each part follows those before it, in words; empty where it does so without a gap or an overlap.

    Args:
        parts: by their first log times.
    """
    least_gap_ns = _GAP_INTERVALS * _interval_ns(parts)
    latest: PartSpan | None = None
    texts = []
    for part in parts:
        texts.append("" if latest is None else _join(latest, part, least_gap_ns))
        latest = part if latest is None or part.last_ns > latest.last_ns else latest
    return texts


def continuation_notes(part: PartSpan, frames_before_ns: Sequence[int], ended_ns: int) -> tuple[str, ...]:
    """What is to be said of how a part follows the one whose result it goes on from.

    Args:
        part: this one.
        frames_before_ns: log times of the last messages of the reference sensor in the part before, as far as known.
        ended_ns: log time from which on the drive goes on.
    """
    before = PartSpan("what it goes on from", min(frames_before_ns, default=ended_ns), ended_ns, len(frames_before_ns))
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
    """What becomes of the messages of a part that overlaps others."""
    if part.repeats is None:
        return ""
    if not part.repeats:
        return "; no message is in both, they are merged"
    return f"; {part.repeats} of its messages are in parts before it as well, these count once"


def _interval_ns(parts: Iterable[PartSpan]) -> float:
    """Mean interval of the messages that make frames, within the parts."""
    counted = [part for part in parts if part.frames > 1]
    intervals = sum(part.frames - 1 for part in counted)
    return sum(part.last_ns - part.first_ns for part in counted) / intervals if intervals else 0.0


def _differing(kind: str, records: Iterable[Attachment | Metadata]) -> tuple[str, ...]:
    """What has one name and several contents."""
    counts: Counter[str] = Counter(record.name for record in records if record.name not in _OF_EACH_RESULT)
    return tuple(f"{kind} {name}: {n} versions in the parts, all are kept" for name, n in counts.items() if n > 1)
