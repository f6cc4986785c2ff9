"""What part of a log is replayed: a first pass that checks it, and the frames of that part."""

from collections.abc import Iterator
from dataclasses import dataclass

from roadperc_stream import log
from roadperc_stream.assemble import sample_of
from roadperc_stream.channels import ROLES
from roadperc_stream.config import ReplayConfig
from roadperc_stream.datatypes import Sample
from roadperc_stream.errors import ChannelError, LogError
from roadperc_stream.log import LogSummary, Message, MessageDigest
from roadperc_stream.roles import Filled, Problems, fill_roles, is_result, stamped_messages
from roadperc_stream.sync import HELD_KINDS, Held, SyncCounts, reference_role, synchronise

_NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class Cut:
    """What part of a log is replayed: seconds from its first message, and at most so many frames."""

    start_s: float | None = None
    end_s: float | None = None
    frames: int | None = None


WHOLE = Cut()


@dataclass(frozen=True)
class Survey:
    """What a first pass over the log finds: the part to replay, its digest, and what holds at its start."""

    filled: Filled
    start_ns: int | None
    end_ns: int | None
    digest: str
    messages: int
    expected_frames: int
    held: Held


def survey_log(summary: LogSummary, cfg: ReplayConfig, overrides: dict[str, str], cut: Cut) -> Survey:
    """Find the roles and the part to replay, and read that part once: every CRC is checked before work starts."""
    used = [c for c in summary.channels if summary.counts.get(c.source_id)]
    try:
        filled = fill_roles(used, overrides)
        reference = reference_role(filled.topics)
    except ChannelError as error:
        raise ChannelError(f"{summary.path}: {error}") from error
    start_ns, end_ns = _window(summary, cut, filled.topics[reference])
    digest, messages, frames = MessageDigest(), 0, 0
    for message in input_messages(summary, start_ns, end_ns, validate_crcs=True):
        digest.update(message)
        messages += 1
        frames += message.channel.topic == filled.topics[reference]
    if not frames:
        raise LogError(f"{summary.path}: no message on {filled.topics[reference]} in the part asked for")
    held = _held_at(summary, filled, cfg, start_ns)
    return Survey(filled, start_ns, end_ns, digest.hexdigest(), messages, frames, held)


def _window(summary: LogSummary, cut: Cut, reference_topic: str) -> tuple[int | None, int | None]:
    """First log time replayed and first one no longer replayed; None where there is no limit."""
    first_ns = summary.first_ns or 0
    start_ns = None if cut.start_s is None else first_ns + round(cut.start_s * _NANOSECONDS)
    end_ns = None if cut.end_s is None else first_ns + round(cut.end_s * _NANOSECONDS)
    if cut.frames is None:
        return start_ns, end_ns
    messages = log.read(summary.path, topics=[reference_topic], start_ns=start_ns, end_ns=end_ns)
    beyond = next((message for number, message in enumerate(messages) if number == cut.frames), None)
    return start_ns, beyond.log_time_ns if beyond else end_ns


def input_messages(
    summary: LogSummary, start_ns: int | None, end_ns: int | None, *, validate_crcs: bool = False
) -> Iterator[Message]:
    """The messages of a log that no earlier replay wrote."""
    messages = log.read(summary.path, start_ns=start_ns, end_ns=end_ns, validate_crcs=validate_crcs)
    return (message for message in messages if not is_result(message.channel))


def _held_at(summary: LogSummary, filled: Filled, cfg: ReplayConfig, start_ns: int | None) -> Held:
    """Calibrations and transforms that hold at the start: the last ones before it, else the first ones after it."""
    waiting = {role for role in filled.topics if ROLES[role].kind in HELD_KINDS}
    topics = {filled.topics[role] for role in waiting}
    held = Held()
    messages = log.read(summary.path, topics=topics) if topics else iter(())
    for item in stamped_messages(messages, filled, cfg.tag_table, Problems()):
        before = start_ns is not None and item.log_time_ns < start_ns
        if ROLES[item.role].kind in HELD_KINDS and (before or item.role in waiting):
            held = held.updated(item)
            waiting.discard(item.role)
        if not waiting and not before:
            break
    return held


def samples(
    summary: LogSummary, survey: Survey, cfg: ReplayConfig, counts: SyncCounts, problems: Problems
) -> Iterator[Sample]:
    """The frames of the log, in order."""
    filled = survey.filled
    topics = set(filled.topics.values())
    messages = log.read(summary.path, topics=topics, start_ns=survey.start_ns, end_ns=survey.end_ns)
    inputs = (message for message in messages if not is_result(message.channel))
    items = stamped_messages(inputs, filled, cfg.tag_table, problems)
    reference = reference_role(filled.topics)
    for index, moment in enumerate(synchronise(cfg.sync, items, reference, filled.topics, survey.held, counts)):
        try:
            yield sample_of(cfg, moment, index, filled.topics)
        except ChannelError as error:
            raise ChannelError(f"{summary.path}: {error}") from error
