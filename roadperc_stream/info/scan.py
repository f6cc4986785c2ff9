"""Scans a log in one pass: counts all messages, and pairs those of assigned roles to frames like a replay."""

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig, SyncConfig
from roadperc_stream.errors import ConfigError, DecodeError, DumpError, LogError
from roadperc_stream.geometry import Float
from roadperc_stream.info.role_states import Roles, roles_of
from roadperc_stream.info.stamps import StampReader, stamp_reader
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.earlier_replay import is_result, recorded_tag_table, recorded_topics
from roadperc_stream.input.findings import InputEvidence
from roadperc_stream.input.order import OrderConfig
from roadperc_stream.input.replaced import given_for, replaced, with_recorded
from roadperc_stream.input.stream import Problems, decoded_messages
from roadperc_stream.input.sync import StampPairing, reference_of, skew_ns
from roadperc_stream.input.transforms import LatchedState
from roadperc_stream.log import LogSummary, Message, MessageDigest, Salvage
from roadperc_stream.model import CameraImage, DepthImage
from roadperc_stream.model.finding import Finding
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES
from roadperc_stream.system.time import LONGEST_PAUSE_NS, NS_PER_S, seconds_to_ns

_MOST_KEPT: Final = 65_536
"""Most intervals in memory per channel; beyond it every second, fourth, ... interval is kept."""


@dataclass
class Intervals:
    """Times between messages, evenly thinned to bound memory."""

    _kept: "array[int]" = field(default_factory=lambda: array("Q"))
    _stride: int = 1
    _seen: int = 0

    def add(self, interval_ns: int) -> None:
        """Add an interval, an unsigned 64-bit integer like log times."""
        if self._seen % self._stride == 0:
            self._kept.append(interval_ns)
        self._seen += 1
        if len(self._kept) == _MOST_KEPT:
            self._kept, self._stride = self._kept[::2], self._stride * 2

    def median_s(self) -> float | None:
        """The median; None without intervals."""
        return float(np.quantile(self._seconds(), 0.5)) if self._kept else None

    def jitter_s(self) -> float | None:
        """Difference from the median that 95 % do not exceed; None for fewer than two intervals."""
        if len(self._kept) < 2:
            return None
        seconds = self._seconds()
        return float(np.quantile(np.abs(seconds - np.median(seconds)), 0.95))

    def _seconds(self) -> Float:
        """(N,) the kept ones."""
        return np.asarray(self._kept, np.float64) / NS_PER_S


@dataclass
class Tally:
    """The times of one channel's messages, in the order of the file."""

    read_stamp: StampReader | None
    messages: int = 0
    size_bytes: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    intervals: Intervals = field(default_factory=Intervals)
    longest_gap_ns: int = 0
    gap_after_ns: int | None = None
    """Log time of the message before the longest gap."""
    log_times_back: int = 0
    stamps_back: int = 0
    first_back_ns: int | None = None
    """Log time of the first message whose own stamp is earlier than the previous one."""
    stamps_repeated: int = 0
    stamps_unset: int = 0
    """Messages whose schema has a stamp that is zero or unreadable."""
    _last_stamp_ns: int | None = None

    def add(self, log_time_ns: int, data: bytes) -> None:
        """Count a message."""
        if self.messages:
            self._interval(log_time_ns)
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        self.last_ns = max(self.last_ns, log_time_ns)
        self.messages += 1
        self.size_bytes += len(data)
        if self.read_stamp is not None:
            self._stamp(self.read_stamp(data), log_time_ns)

    def _interval(self, log_time_ns: int) -> None:
        interval_ns = log_time_ns - self.last_ns
        if interval_ns < 0:
            self.log_times_back += 1
            return
        self.intervals.add(interval_ns)
        if interval_ns > self.longest_gap_ns:
            self.longest_gap_ns, self.gap_after_ns = interval_ns, self.last_ns

    def _stamp(self, stamp_ns: int | None, log_time_ns: int) -> None:
        if stamp_ns is None:
            self.stamps_unset += 1
            return
        if self._last_stamp_ns is not None:
            self.stamps_repeated += stamp_ns == self._last_stamp_ns
            if stamp_ns < self._last_stamp_ns:
                self.stamps_back += 1
                self.first_back_ns = log_time_ns if self.first_back_ns is None else self.first_back_ns
        self._last_stamp_ns = stamp_ns


_MOST_SORTED: Final = 100_000
"""Most messages of roles, without their content, that wait in memory to be sorted by log time."""


@dataclass
class Scan:
    """The findings of one pass over a log."""

    salvage: Salvage
    roles: Roles
    summary: LogSummary | None
    """None for a damaged file."""
    cfg: ReplayConfig = field(default_factory=ReplayConfig)
    """With what an earlier replay recorded about its log."""
    evidence: InputEvidence = field(default_factory=lambda: InputEvidence({}))
    tallies: dict[int, Tally] = field(default_factory=dict)
    """By ``Channel.source_id``."""
    problems: Problems = field(default_factory=Problems)
    latched: LatchedState = field(default_factory=LatchedState)
    frames: int = 0
    segments: int = 1
    """One more than the number of times that the stamps restarted or jumped ahead."""
    dropped: Counter[str] = field(default_factory=Counter)
    """Messages per role that belong to no frame."""
    alone: Counter[str] = field(default_factory=Counter)
    """Frames without a message of an assigned role, by role."""
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    """(width, height) of the first readable image, by role."""
    skew_ns: int | None = None
    log_times_back: int = 0
    pauses_ns: int = 0
    """Sum of the pauses of more than an hour between messages of any channel."""
    inputs: int = 0
    """Number of messages that are not results."""
    inputs_back: int = 0
    _digest: MessageDigest = field(default_factory=MessageDigest)

    @classmethod
    def of(cls, source: log.AnyLog, overrides: Mapping[str, str], cfg: ReplayConfig) -> "Scan":
        """The finished scan of a log.

        Raises:
            LogError: the file cannot be opened, or is not a log.
        """
        first, salvage = log.audited(source), Salvage(source)
        summary = None
        if first.whole:
            with suppress(LogError):
                summary = log.summarise(source)
        metadata = first.described.metadata
        channels = tuple(first.channels[number] for number in sorted(first.channels) if first.counts[number])
        named = {**recorded_topics(metadata, channels), **overrides}
        roles = roles_of(channels, named)
        assignment = replace(roles.assignment, tag_table=recorded_tag_table(metadata))
        with suppress(ConfigError):  # the record of a result is listed with its fault
            cfg = with_recorded(cfg, first.described.attachments, first.path)
        scan = cls(salvage, replace(roles, assignment=assignment), summary, cfg)
        scan.evidence = InputEvidence(cfg.labels, scan._count(first, "segmentation"))
        scan._run()
        scan._replace_cameras()
        return scan

    def _count(self, first: Salvage, role: str) -> int:
        topic = self.roles.assignment.topics.get(role)
        return sum(first.counts[number] for number, channel in first.channels.items() if channel.topic == topic)

    def _replace_cameras(self) -> None:
        """Replace the log's cameras and mountings by those of the configuration."""
        reference = self.roles.assignment.reference
        if self.summary is not None and reference is not None:
            try:
                given = given_for(self.summary, self.roles.assignment, self.cfg)
                self.latched = replaced(self.latched, given, reference)
            except DumpError as error:
                self.roles = replace(self.roles, refusal=str(error))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The contradictions in the input."""
        roles = self.roles.assignment
        return self.evidence.findings(self.cfg, roles.topics, roles.reference, self.latched) if roles.reference else ()

    def digest(self) -> str | None:
        """Digest of the input's messages in log-time order; None if a message is unreadable.

        Reads the messages again if the file is in another order.
        """
        if self.summary is None or not self.salvage.whole or not self.inputs:
            return None
        if not self.inputs_back:
            return self._digest.hexdigest()
        digest = MessageDigest()
        for message in log.read(self.summary):
            if not is_result(message.channel):
                digest.update(message)
        return digest.hexdigest()

    def _run(self) -> None:
        roles = self.roles.assignment
        items = self._without_latched(
            decoded_messages(self._counted(self.salvage.messages()), roles, self.cfg, self.problems)
        )
        if roles.reference is None:
            for _ in items:
                pass
            return

        def drop(item: Stamped) -> None:
            self.dropped[item.role] += 1

        cfg = SyncConfig()
        wait_ns = seconds_to_ns(cfg.max_wait_s)
        order = OrderConfig(roles.reference, wait_ns, lateness_ns=wait_ns)
        pairing = StampPairing(cfg, order, roles.topics, LatchedState(), drop)
        paired = [role for role in roles.topics if ROLES[role].kind not in LATCHED_KINDS]
        sorted_items = log.in_order_within(items, lambda item: item.log_time_ns, lambda _: 1, _MOST_SORTED)
        for paired_now in pairing.frames_of(sorted_items):
            self.frames += 1
            self.segments = max(self.segments, reference_of(paired_now).segment + 1)
            self.alone.update(role for role in paired if role not in paired_now)
            if (skew := skew_ns(paired_now)) is not None:
                self.skew_ns = max(self.skew_ns or 0, skew)

    def _counted(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Count the messages and pass them on."""
        latest_ns, latest_input_ns = None, 0
        for message in messages:
            step_ns = 0 if latest_ns is None else message.log_time_ns - latest_ns
            self.log_times_back += step_ns < 0
            self.pauses_ns += step_ns if step_ns > LONGEST_PAUSE_NS else 0
            latest_ns = max(latest_ns or 0, message.log_time_ns)
            source_id = message.channel.source_id
            if source_id not in self.tallies:
                self.tallies[source_id] = Tally(stamp_reader(message.channel))
            self.tallies[source_id].add(message.log_time_ns, message.data)
            if not is_result(message.channel):
                self.inputs += 1
                self.inputs_back += message.log_time_ns < latest_input_ns
                latest_input_ns = max(latest_input_ns, message.log_time_ns)
                self._digest.update(message)
            yield message

    def _without_latched(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        """The items to pair, without content; calibrations and transforms go to ``latched``."""
        for item in items:
            self.evidence.add([item])
            if ROLES[item.role].kind in LATCHED_KINDS:
                self.latched = self.latched.updated(item.role, item.payload)
            else:
                if item.role not in self.sizes and isinstance(item.payload, CameraImage | DepthImage):
                    with suppress(DecodeError):
                        self.sizes[item.role] = item.payload.size
                yield replace(item, payload=())
