"""Notes on one pass over a log: gaps between its files, segments, and messages that belong to no frame."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Final

from roadperc_stream.config import SyncConfig
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.sync import Paired, reference_of
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
    """Written frames that the continued result also has."""
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

    def add(self, paired: Paired, segment: int, *, is_written: bool = True, is_again: bool = False) -> None:
        """Count a frame; ``is_again`` if the continued result has it too."""
        self.paired.update(paired)
        if is_written:
            self.frames += 1
            self.given_again += is_again
            self.segment_frames[segment] += 1
            self.segment_stamps_ns.setdefault(segment, reference_of(paired).stamp_ns)

    def drop(self, item: Stamped) -> None:
        """Count a message that belongs to no frame."""
        self.dropped[item.role] += 1
        self.dropped_stamps_ns.setdefault(item.role, item.stamp_ns)

    def notes(self, topics: Mapping[str, str], cfg: SyncConfig, nearest_ns: Mapping[str, int]) -> Iterator[str]:
        """Notes for the user.

        ``nearest_ns`` is the smallest distance of each role's dropped messages to a frame.
        """
        if self.given_again:
            yield f"{self.given_again} of {self.frames} frames are also in the continued result"
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
        for role, messages in self.dropped.items():
            first = f"{'the first with ' if messages > 1 else ''}stamp {self.dropped_stamps_ns[role]} ns"
            yield f"{messages} on {topics[role]}, {first}"


def _never_near(topic: str, tolerance_s: float, nearest_ns: int) -> str:
    off = f"{ns_to_seconds(nearest_ns):.9f}".rstrip("0").rstrip(".")
    return f"{topic}: in no frame; the nearest message is {off} s from one, sync.tolerance_s is {tolerance_s:g}"


@dataclass(frozen=True)
class FileSpan:
    """First and last log time of a file's messages, and the number that make frames.

    ``repeats`` is the number of messages that an earlier file also has; None if unknown.
    """

    name: str
    first_ns: int
    last_ns: int
    frames: int
    repeats: int | None = None


def file_notes(summary: LogSummary, topic: str) -> tuple[str, ...]:
    """Notes on gaps, overlaps and differences between the files of a log; empty for a single file."""
    spans = [
        FileSpan(str(file.path), file.first_ns, file.last_ns, counted_topics(file)[topic], file.repeats)
        for file in summary.files
        if file.first_ns is not None and file.last_ns is not None and any(file.counts.values())
    ]
    joined = tuple(joins(spans))
    more = (f"{len(joined) - _MOST_NAMED} more files leave gaps or overlap",) if len(joined) > _MOST_NAMED else ()
    differing = (*_differing("attachment", summary.attachments), *_differing("metadata", summary.metadata))
    return (*joined[:_MOST_NAMED], *more, *(differing if summary.files else ()))


def joins(files: Sequence[FileSpan]) -> Iterator[str]:
    """A text for each file that has a gap or overlap to earlier files; ``files`` are sorted by first log time."""
    least_gap_ns = _GAP_INTERVALS * _interval_ns(files)
    for number, file in enumerate(files[1:], 1):
        if text := _join(max(files[:number], key=lambda before: before.last_ns), file, least_gap_ns):
            yield text


def _join(before: FileSpan, file: FileSpan, least_gap_ns: float) -> str:
    gap_ns = file.first_ns - before.last_ns
    if gap_ns < 0:
        overlap_s = ns_to_seconds(min(-gap_ns, file.last_ns - file.first_ns))
        return f"{file.name}: overlaps {before.name} by {overlap_s:.3f} s{_shared(file)}"
    if file.repeats:
        return f"{file.name}: begins when {before.name} ends{_shared(file)}"
    if gap_ns > least_gap_ns:
        return f"{file.name}: begins {ns_to_seconds(gap_ns):.3f} s after {before.name} ends"
    return ""


def _shared(file: FileSpan) -> str:
    """The treatment of a file's messages that overlap others."""
    if file.repeats is None:
        return ""
    if not file.repeats:
        return "; they share no message and are merged"
    return f"; {file.repeats} of its messages are also in earlier files and count once"


def _interval_ns(files: Iterable[FileSpan]) -> float:
    """Mean interval of the messages that make frames, within the files."""
    counted = [file for file in files if file.frames > 1]
    intervals = sum(file.frames - 1 for file in counted)
    return sum(file.last_ns - file.first_ns for file in counted) / intervals if intervals else 0.0


def _differing(kind: str, records: Iterable[Attachment | Metadata]) -> tuple[str, ...]:
    """Notes on records with the same name and different contents."""
    counts: Counter[str] = Counter(record.name for record in records if record.name not in _OF_EACH_RESULT)
    return tuple(f"{kind} {name}: {n} versions in the files; all are kept" for name, n in counts.items() if n > 1)
