"""One pass over a log: every message is counted, and those of filled roles are paired to frames as a replay would."""

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Final

from roadperc_stream import log
from roadperc_stream.core.config import SyncConfig
from roadperc_stream.core.datatypes import CameraImage, DepthImage
from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.info.role_states import Roles, roles_of
from roadperc_stream.info.stamps import stamp_reader
from roadperc_stream.info.tally import Tally
from roadperc_stream.input.plan import without_loops
from roadperc_stream.input.roles.fill import Problems, chosen_tag_table, chosen_topics, is_result, stamped_messages
from roadperc_stream.input.roles.probe import holds
from roadperc_stream.input.sync import HELD_KINDS, Held, Stamped, SyncCounts, synchronise
from roadperc_stream.log import Channel, Message, MessageDigest, Metadata, Salvage
from roadperc_stream.schemas.roles import ROLES

_MOST_SORTED: Final = 100_000
"""Messages of roles, without their content, that are held to be put in the order of log time."""


@dataclass
class Scan:
    """What a pass has found; complete when ``run`` has returned."""

    salvage: Salvage
    roles: Roles
    tallies: dict[int, Tally] = field(default_factory=dict)
    """By ``Channel.source_id``."""
    problems: Problems = field(default_factory=Problems)
    held: Held = field(default_factory=Held)
    counts: SyncCounts = field(default_factory=SyncCounts)
    alone: Counter[str] = field(default_factory=Counter)
    """Frames without a message of a filled role, by role."""
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    """(width, height) of the first image that can be decoded, by role."""
    skew_ns: int | None = None
    log_times_back: int = 0
    inputs: int = 0
    """Messages that are no results."""
    inputs_back: int = 0
    _digest: MessageDigest = field(default_factory=MessageDigest)

    @classmethod
    def of(cls, path: Path, overrides: Mapping[str, str]) -> "Scan":
        """The finished scan of a log.

        Raises:
            LogError: the file cannot be opened, or is no log at all.
        """
        salvage = Salvage(path)
        channels = _used_channels(salvage)
        metadata = _metadata(path)
        named = {**chosen_topics(metadata, channels), **overrides}
        roles = roles_of(channels, named, cache(partial(holds, path)))
        filled = replace(roles.filled, tag_table=chosen_tag_table(metadata))
        scan = cls(salvage, replace(roles, filled=filled))
        scan._run()
        return scan

    def digest(self) -> str | None:
        """Digest of the input's messages in log-time order; None where some cannot be read.

        Where the file has them in another order they are read once more.
        """
        if not self.salvage.whole or not self.inputs:
            return None
        if not self.inputs_back:
            return self._digest.hexdigest()
        digest = MessageDigest()
        for message in log.read(self.salvage.path):
            if not is_result(message.channel):
                digest.update(message)
        return digest.hexdigest()

    def _run(self) -> None:
        filled = self.roles.filled
        decoded = stamped_messages(self._counted(self.salvage.messages()), filled, "auto", self.problems)
        items = self._without_held(without_loops(decoded, self.held, filled, self.problems))
        if self.roles.reference is None:
            for _ in items:
                pass
            return
        ordered, topics = in_log_time_order(items, _MOST_SORTED), filled.topics
        paired = [role for role in topics if ROLES[role].kind not in HELD_KINDS]
        for moment in synchronise(SyncConfig(), ordered, self.roles.reference, topics, Held(), self.counts):
            self.alone.update(role for role in paired if role not in moment.parts)
            if moment.skew_ns is not None:
                self.skew_ns = max(self.skew_ns or 0, moment.skew_ns)

    def _counted(self, messages: Iterable[Message]) -> Iterator[Message]:
        """The messages as they come, each counted."""
        latest_ns = latest_input_ns = 0
        for message in messages:
            self.log_times_back += message.log_time_ns < latest_ns
            latest_ns = max(latest_ns, message.log_time_ns)
            self._tally_of(message.channel).add(message.log_time_ns, message.data)
            if not is_result(message.channel):
                self.inputs += 1
                self.inputs_back += message.log_time_ns < latest_input_ns
                latest_input_ns = max(latest_input_ns, message.log_time_ns)
                self._digest.update(message)
            yield message

    def _tally_of(self, channel: Channel) -> Tally:
        tally = self.tallies.get(channel.source_id)
        if tally is None:
            tally = self.tallies[channel.source_id] = Tally(stamp_reader(channel))
        return tally

    def _without_held(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        """The items that are paired, without their content; calibrations and transforms are kept."""
        for item in items:
            if ROLES[item.role].kind in HELD_KINDS:
                self.held = self.held.updated(item)
            else:
                self._measure(item)
                yield replace(item, payload=())

    def _measure(self, item: Stamped) -> None:
        """Keep the size of a camera's first image."""
        if item.role in self.sizes or not isinstance(item.payload, CameraImage | DepthImage):
            return
        try:
            pixels = item.payload.grey if isinstance(item.payload, CameraImage) else item.payload.depth_m
        except DecodeError:
            return
        self.sizes[item.role] = (pixels.shape[1], pixels.shape[0])


def in_log_time_order(items: Iterable[Stamped], most: int) -> Iterator[Stamped]:
    """Items by log time, those of equal time as they came, as far as holding ``most`` of them can tell."""
    waiting: list[tuple[int, int, Stamped]] = []
    for number, item in enumerate(items):
        heapq.heappush(waiting, (item.log_time_ns, number, item))
        if len(waiting) > most:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def _metadata(path: Path) -> tuple[Metadata, ...]:
    """What a result says of how it was made; nothing of a damaged file, whose metadata come too late."""
    try:
        return log.summarise(path).metadata
    except LogError:
        return ()


def _used_channels(salvage: Salvage) -> tuple[Channel, ...]:
    """The channels that hold messages, which a log without an index tells only when it has been read."""
    indexed = salvage.indexed_channels
    if indexed is not None:
        return indexed
    first = Salvage(salvage.path)
    for _ in first.messages():
        pass
    return tuple(first.channels[number] for number in sorted(first.counts))
