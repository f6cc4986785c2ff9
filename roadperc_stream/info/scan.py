"""Scans a log: counts all messages, and pairs those of assigned roles to frames like a replay."""

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig, SyncConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.info.facts import ChannelFacts, ReplayFacts
from roadperc_stream.info.measures import Measures
from roadperc_stream.info.role_states import Roles
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.findings import InputEvidence
from roadperc_stream.input.order import OrderConfig
from roadperc_stream.input.stream import Problems, decoded_messages
from roadperc_stream.input.sync import StampPairing, reference_of, skew_ns
from roadperc_stream.input.transforms import LatchedState
from roadperc_stream.log import Channel, Message, MessageDigest
from roadperc_stream.model import CameraImage, DepthImage
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES
from roadperc_stream.system.time import LONGEST_PAUSE_NS, NS_PER_S, ns_to_seconds, seconds_to_ns

_MOST_KEPT: Final = 65_536
"""Most intervals in memory per channel; beyond it every second, fourth, ... interval is kept."""
_MOST_SORTED: Final = 100_000
"""Most messages of roles, without their content, that wait in memory to be sorted by log time."""


class Tally:
    """Counts the messages of a channel in its facts."""

    def __init__(self, facts: ChannelFacts) -> None:
        self.facts = facts
        self._latest_ns = self._longest_gap_ns = 0
        self.gap_after_ns: int | None = None
        """Log time of the message before the longest gap."""
        self._intervals, self._stride = array("Q"), 1
        """Intervals, evenly thinned to bound memory."""
        self._stamp_ns: int | None = None

    def add(self, log_time_ns: int, data: bytes) -> None:
        """Count a message."""
        facts = self.facts
        if log_time_ns < self._latest_ns:
            facts.log_times_back += 1
        elif facts.messages:
            self._add_interval(log_time_ns - self._latest_ns)
        self._latest_ns = facts.last_ns = max(self._latest_ns, log_time_ns)
        facts.first_ns = log_time_ns if facts.first_ns is None else min(facts.first_ns, log_time_ns)
        facts.messages += 1
        facts.size_bytes += len(data)

    def _add_interval(self, interval_ns: int) -> None:
        if interval_ns > self._longest_gap_ns:
            self._longest_gap_ns, self.gap_after_ns = interval_ns, self._latest_ns
        if self.facts.messages % self._stride == 0:
            self._intervals.append(interval_ns)
        if len(self._intervals) == _MOST_KEPT:
            self._intervals, self._stride = self._intervals[::2], self._stride * 2

    def add_stamp(self, stamp_ns: int) -> None:
        """Count the own stamp of a message."""
        if self._stamp_ns is not None:
            self.facts.stamps_back += stamp_ns < self._stamp_ns
            self.facts.stamps_repeated += stamp_ns == self._stamp_ns
        self._stamp_ns = stamp_ns

    def finish(self, first_ns: int) -> None:
        """Fill in the rate and the longest gap; ``first_ns`` is the log's first time."""
        if self._intervals:
            median_s = float(np.median(self._intervals)) / NS_PER_S
            self.facts.rate_hz = 1 / median_s if median_s else None
            self.facts.longest_gap_s = ns_to_seconds(self._longest_gap_ns) if median_s else None
        if self.gap_after_ns is not None:
            self.facts.gap_at_s = ns_to_seconds(self.gap_after_ns - first_ns)


class Scan:
    """Counts the messages of a log, in the order of the file, in the facts of its channels and of its replay."""

    def __init__(self, roles: Roles, cfg: ReplayConfig, evidence: InputEvidence, measures: Measures | None) -> None:
        self.roles, self.cfg, self.evidence, self.measures = roles.assignment, cfg, evidence, measures
        self.replay = ReplayFacts(
            roles.refusal, roles.options, roles.assignment.notes, roles.states, roles.assignment.reference
        )
        self.tallies: dict[int, Tally] = {}
        """By ``Channel.source_id``, of channels with messages."""
        self.latched = LatchedState()
        self.sizes: dict[str, tuple[int, int]] = {}
        """(width, height) of the first readable image, by role."""
        self.log_times_back = self.pauses_ns = 0
        """Messages after one of any channel with a later log time; sum of the pauses of more than an hour."""
        self.inputs = self.inputs_back = 0
        """Messages that are not results; those after one with a later log time."""
        self.digest = MessageDigest()
        """Of the inputs, in the order of the file."""
        self._problems = Problems()
        self._stamped = {topic: role for role, topic in self.roles.topics.items()}
        """The role by which the stamps of a topic are counted."""
        self._tally_of: dict[str, Tally] = {}
        """By topic; the topic of a role has one channel."""

    def run(self, messages: Iterable[Message]) -> None:
        """Count the messages, and pair those of roles."""
        items = self._to_pair(decoded_messages(self._counted(messages), self.roles, self.cfg, self._problems))
        if self.roles.reference is None:
            for _ in items:
                pass
        else:
            self._pair(items, self.roles.reference)
        first_ns = self.first_ns or 0
        for tally in self.tallies.values():
            tally.finish(first_ns)
        self.replay.unreadable, self.replay.problems = dict(self._problems.counts), tuple(self._problems.first.values())

    @property
    def first_ns(self) -> int | None:
        """The first log time; None without messages."""
        firsts = (tally.facts.first_ns for tally in self.tallies.values())
        return min((first_ns for first_ns in firsts if first_ns is not None), default=None)

    def _pair(self, items: Iterable[Stamped], reference: str) -> None:
        unused, alone = Counter[str](), Counter[str]()

        def drop(item: Stamped) -> None:
            unused[item.role] += 1

        cfg = SyncConfig()
        wait_ns = seconds_to_ns(cfg.max_wait_s)
        order = OrderConfig(reference, wait_ns, lateness_ns=wait_ns)
        pairing = StampPairing(cfg, order, self.roles.topics, LatchedState(), drop)
        paired = [role for role in self.roles.topics if ROLES[role].kind not in LATCHED_KINDS]
        in_order = log.in_order_within(items, lambda item: item.log_time_ns, lambda _: 1, _MOST_SORTED)
        for frame in pairing.frames_of(in_order):
            self.replay.frames += 1
            self.replay.segments = max(self.replay.segments, reference_of(frame).segment + 1)
            alone.update(role for role in paired if role not in frame)
            if (skew := skew_ns(frame)) is not None:
                self.replay.skew_s = max(self.replay.skew_s or 0.0, ns_to_seconds(skew))
        self.replay.unused, self.replay.alone = dict(unused), dict(alone)

    def _counted(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Count the messages and pass them on."""
        latest_ns, latest_input_ns = None, 0
        for message in messages:
            step_ns = 0 if latest_ns is None else message.log_time_ns - latest_ns
            self.log_times_back += step_ns < 0
            self.pauses_ns += step_ns if step_ns > LONGEST_PAUSE_NS else 0
            latest_ns = max(latest_ns or 0, message.log_time_ns)
            channel = message.channel
            if channel.source_id not in self.tallies:
                self.tallies[channel.source_id] = self._tally_of[channel.topic] = Tally(channel_facts(channel))
            self.tallies[channel.source_id].add(message.log_time_ns, message.data)
            if not is_result(channel):
                self.inputs += 1
                self.inputs_back += message.log_time_ns < latest_input_ns
                latest_input_ns = max(latest_input_ns, message.log_time_ns)
                self.digest.update(message)
                if self.measures is not None:
                    self.measures.count(message)
            yield message

    def _to_pair(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        """The items to pair, without content; calibrations and transforms go to ``latched``."""
        for item in items:
            self.evidence.add([item])
            topic = self.roles.topics[item.role]
            if self._stamped[topic] == item.role:
                self._tally_of[topic].add_stamp(item.stamp_ns)
                if self.measures is not None:
                    self.measures.topics[topic].add(item)
            if item.is_latched:
                self.latched = self.latched.updated(item.role, item.payload)
                continue
            if item.role not in self.sizes and isinstance(item.payload, CameraImage | DepthImage):
                with suppress(DecodeError):
                    self.sizes[item.role] = item.payload.size
            yield replace(item, payload=())


def channel_facts(channel: Channel) -> ChannelFacts:
    """The facts of a channel without messages."""
    is_ours = PRODUCER in channel.metadata
    schema = channel.schema_name, channel.schema_encoding
    return ChannelFacts(channel.topic, *schema, channel.message_encoding, is_ours)
