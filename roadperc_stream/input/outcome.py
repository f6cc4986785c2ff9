"""What became of a log's messages in one pass: the frames by segment, and the messages that belong to none."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from roadperc_stream.core.config import SyncConfig
from roadperc_stream.core.time import ns_to_seconds
from roadperc_stream.input.stream import Stamped
from roadperc_stream.input.sync import SyncedMessages

_MOST_NAMED: Final = 5


@dataclass
class SegmentFrames:
    """A segment, the stamp it begins with, and how many of its frames there are so far."""

    number: int
    first_stamp_ns: int
    frames: int = 1


@dataclass
class DroppedMessages:
    """The messages of a role that belong to no frame: how many so far, and the stamp of the first."""

    first_stamp_ns: int
    messages: int = 1


@dataclass
class InputOutcome:
    """What became of the messages so far; of many segments the first ones are named.

    Args:
        begun_segment: the segment at the beginning.
    """

    begun_segment: int = 0
    frames: int = 0
    given_again: int = 0
    """Frames that the part before gave as well."""
    segments: int = 0
    first_segments: list[SegmentFrames] = field(default_factory=list)
    paired: set[str] = field(default_factory=set)
    """Roles of which some frame has a message."""
    dropped: dict[str, DroppedMessages] = field(default_factory=dict)
    _segment: int | None = None

    def add(self, synced: SyncedMessages) -> None:
        """Count a frame that is written."""
        reference = synced.reference
        self.frames += 1
        self.given_again += reference.place.carried
        if reference.segment != self._segment:
            self._segment = reference.segment
            self.segments += 1
            if self.segments <= _MOST_NAMED:
                self.first_segments.append(SegmentFrames(reference.segment, reference.stamp_ns))
        elif self.segments <= _MOST_NAMED:
            self.first_segments[-1].frames += 1

    def pair(self, synced: SyncedMessages) -> None:
        """Take note of the roles that a frame has."""
        self.paired.update(synced.parts)

    def drop(self, item: Stamped) -> None:
        """Count a message that belongs to no frame."""
        known = self.dropped.get(item.role)
        if known is None:
            self.dropped[item.role] = DroppedMessages(item.stamp_ns)
        else:
            known.messages += 1

    def notes(self, topics: Mapping[str, str], cfg: SyncConfig, nearest_ns: Mapping[str, int]) -> Iterator[str]:
        """What the user should know of it.

        Args:
            topics: of the roles.
            cfg: how far the stamps of a frame's messages may differ.
            nearest_ns: how near the messages of each role that belong to no frame came to one.
        """
        if self.given_again:
            yield f"{self.given_again} of {self.frames} frames are in the part before as well, and given again"
        if self._segment is not None and self._segment > self.begun_segment:
            yield self._segments_in_words()
        if self.dropped:
            by_topic = {topics[role]: found for role, found in self.dropped.items()}
            yield f"messages that belong to no frame: {'; '.join(_grouped(by_topic))}"
        for role in self.dropped:
            if role in nearest_ns and role not in self.paired:
                yield _never_near(topics[role], cfg.tolerance_s, nearest_ns[role])

    def _segments_in_words(self) -> str:
        named = [f"{s.number} from stamp {s.first_stamp_ns} ns, {s.frames} frames" for s in self.first_segments]
        more = [f"and {self.segments - len(named)} more"] if self.segments > len(named) else []
        return f"{self.segments} segments, the stages' memory begins anew in each: {'; '.join(named + more)}"


def _grouped(dropped: Mapping[str, DroppedMessages]) -> Iterator[str]:
    """Numbers, topics and first stamps; topics that agree in the others together."""
    groups: dict[tuple[int, int], list[str]] = {}
    for topic, found in dropped.items():
        groups.setdefault((found.messages, found.first_stamp_ns), []).append(topic)
    for (messages, stamp_ns), topics in groups.items():
        stamp = f"{'the first with ' if messages > 1 else ''}stamp {stamp_ns} ns"
        yield f"{messages} on {_listed(topics)}, {stamp}"


def _listed(topics: Iterable[str]) -> str:
    names = list(topics)
    return names[0] if len(names) == 1 else f"each of {', '.join(names)}"


def _never_near(topic: str, tolerance_s: float, nearest_ns: int) -> str:
    off = f"{ns_to_seconds(nearest_ns):.9f}".rstrip("0").rstrip(".")
    return f"{topic}: in no frame, the nearest message is {off} s from one: sync.tolerance_s is {tolerance_s:g}"
