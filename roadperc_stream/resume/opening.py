"""Opens a log for a replay: its frames, the state before the first one, and whether its output is already complete."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Final

from roadperc_stream import __version__, log
from roadperc_stream.chain.encoding import decode, encode
from roadperc_stream.chain.own_stage import OwnStages
from roadperc_stream.chain.step import ChainState, step
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ConfigError, NoFrameError, StateError, TableError
from roadperc_stream.input import ReplayInput, ReplaySource, input_of
from roadperc_stream.input.earlier_replay import is_result, replay_record
from roadperc_stream.input.replaced import with_recorded
from roadperc_stream.input.source import ReadableLog
from roadperc_stream.input.state import FrameNumbers
from roadperc_stream.log import DIGEST_ALGORITHM, Attachment, LogSummary
from roadperc_stream.model.finding import decoded_findings
from roadperc_stream.output.tables import config_text, read_footer
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import ReplaySummary
from roadperc_stream.resume.state import Notes, ReplayState, SavedState, settings_of, state_at_begin, state_at_end
from roadperc_stream.schemas import record
from roadperc_stream.schemas.topics import result_schemas
from roadperc_stream.system.threads import one_thread
from roadperc_stream.system.time import TimeRange, ns_to_seconds, seconds_to_ns

_MEDIA_TYPE: Final = "application/zstd"
"""Media type of an attached state."""
_MOST_FRAMES: Final = 2**32
"""A log numbers its messages with 32 bits."""


@dataclass(frozen=True)
class OpenedLog:
    """The input of a replay, and the saved state that it begins with, if there is one."""

    input: ReplayInput
    begin: SavedState | None = None
    notes: Notes = ()
    warnings: tuple[str, ...] = ()
    """Warnings about a damaged log."""

    def saved_for(self, cfg: ReplayConfig) -> SavedState | None:
        """The saved state that a replay with these settings begins with."""
        return None if self.begin is None else self.begin.with_settings(cfg)

    def state_for(self, cfg: ReplayConfig) -> ReplayState:
        """The state of a replay with these settings before the first frame."""
        saved = self.saved_for(cfg)
        return ReplayState() if saved is None else saved.replay

    def attachments(
        self, cfg: ReplayConfig, end: ReplayState | bytes, *, with_messages: bool
    ) -> tuple[tuple[Attachment, ...], Notes]:
        """The states that the result begins and ends with, and notes for the user.

        ``end`` is the state after the last complete frame, or its bytes. It carries its messages if the output does
        not (``with_messages``).
        """
        begin, log_in = self.saved_for(cfg), self.input
        states = () if begin is None else (Attachment(record.BEGIN_ATTACHMENT, _MEDIA_TYPE, encode(begin)),)
        waiting = log_in.end_state(with_messages=with_messages)
        try:
            state = decode(end, ReplayState) if isinstance(end, bytes) else end
            saved = SavedState(log_in.log_id, settings_of(cfg), waiting, state, log_in.lost_to_come)
            return (*states, Attachment(record.STATE_ATTACHMENT, _MEDIA_TYPE, encode(saved))), ()
        except StateError as error:  # the results do not depend on it
            return states, (f"{record.STATE_ATTACHMENT}: left out, this result cannot be continued: {error}",)

    def facts(self) -> dict[str, str]:
        """Which log the replay continues, for the output to record."""
        return {record.CONTINUES_KEY: self.begin.log_id} if self.begin is not None and self.begin.log_id else {}

    def table_facts(self) -> dict[str, str]:
        """The log facts for the tables, and the number of a continued replay's first frame."""
        log_id = {record.LOG_ID_KEY: self.input.log_id, record.DIGEST_ALGORITHM_KEY: DIGEST_ALGORITHM}
        if self.begin is None or not self.begin.log_id:
            return log_id
        return {**log_id, **self.facts(), record.FIRST_FRAME_KEY: str(self.begin.input.numbers.next)}


@dataclass(frozen=True)
class ReplayOptions:
    """How a replay runs.

    Args:
        continued: the result to continue.
        warm_up_s: seconds of log before the start whose frames build the state and are not written.
        checkpoint_every_s: seconds of log between two checkpoints; None for no checkpoints.
        resume: continue from the latest checkpoint, if there is one.
        threads: number of threads; the output does not depend on it, except for timing columns.
        own: stages of the user's own, which ``own_stages`` loads for a configuration.
    """

    continued: Path | None = None
    warm_up_s: float = 0.0
    checkpoint_every_s: float | None = None
    resume: bool = False
    threads: int = 1
    own: OwnStages = field(default_factory=dict)


PLAIN: Final = ReplayOptions()


def open_replay(source: ReplaySource, cfg: ReplayConfig, options: ReplayOptions) -> OpenedLog:
    """Open a log, with the state that the replay begins with.

    Raises:
        ConfigError: the options contradict each other; else as ``open_log``.
    """
    continued, warm_up_s = options.continued, options.warm_up_s
    if warm_up_s and continued is not None:
        raise ConfigError("warm_up_s: --warm-up cannot be combined with --continue")
    if warm_up_s and source.time_range.start_s is None:
        raise ConfigError("warm_up_s: expected a start; pass --start too")
    if continued is not None:
        return _open_continued(source, cfg, continued)
    return _open_warmed(source, cfg, warm_up_s, options.own) if warm_up_s else open_log(source, cfg)


def open_log(source: ReplaySource, cfg: ReplayConfig) -> OpenedLog:
    """Open a log. If a replay wrote it, begin with the state that this replay began with.

    Raises:
        ChannelError: the channels do not fit the roles.
        LogError: the log cannot be read, is damaged, or the requested part has no frame.
        StateError: its saved state cannot be read.
    """
    found = source.read(cfg.limits)
    cfg = with_recorded(cfg, found.summary.attachments, found.summary.path)
    return _opened(found, source, cfg, *state_at_begin(found.summary, cfg, source.time_range))


def _open_continued(source: ReplaySource, cfg: ReplayConfig, before: Path) -> OpenedLog:
    """Open a log that continues an earlier result.

    Raises:
        StateError: the log does not follow the result; else as ``open_log``.
    """
    begin = state_at_end(before, cfg)
    opened = _opened(source.read(cfg.limits), source, cfg, begin)
    summary, starts_ns, ended_ns = opened.input.summary, opened.input.span_ns[0], begin.input.from_ns
    if summary.first_ns is not None and starts_ns < ended_ns:
        lead_s, start_s = ns_to_seconds(ended_ns - starts_ns), ns_to_seconds(begin.input.next_ns - summary.first_ns)
        raise StateError(
            f"{summary.path}: begins {lead_s:.3f} s before the end of {before}: expected later messages; "
            f"pass --start {start_s:.9f} to skip the overlap, or pass all files of the log together"
        )
    return opened


def _open_warmed(source: ReplaySource, cfg: ReplayConfig, warm_up_s: float, own: OwnStages) -> OpenedLog:
    """Open a part of a log, with the state after a warm-up on the seconds before it.

    Raises:
        LogError: these seconds are damaged, which would change the state; else as ``open_log``.
    """
    found = source.read(cfg.limits)
    cfg = with_recorded(cfg, found.summary.attachments, found.summary.path)
    start_s, first_ns = found.part(source.time_range).start_s or 0.0, found.summary.first_ns or 0
    short = (f"warm-up: {start_s:g} s; the log has no more before the start",) if start_s < warm_up_s else ()
    lead = replace(source, time_range=TimeRange(start_s - warm_up_s, start_s))
    start_ns = first_ns + seconds_to_ns(start_s)
    if not source.recover:
        found.require_outside(first_ns + seconds_to_ns(start_s - warm_up_s), start_ns)
    begin = _warmed(found.summary, lead, cfg, start_ns, own) if start_s > 0 else None
    return _opened(found, source, cfg, begin, short)


def _opened(
    found: ReadableLog, source: ReplaySource, cfg: ReplayConfig, begin: SavedState | None, notes: Notes = ()
) -> OpenedLog:
    """The input of a replay that begins with a state."""
    log_in = input_of(found, source, cfg, *(() if begin is None else (begin.input, begin.lost)))
    first = log_in.plan.start.numbers.next
    if first < 0 or first + log_in.expected_frames > _MOST_FRAMES:
        raise StateError(f"frame {first} and {log_in.expected_frames} more: a log numbers {_MOST_FRAMES} at most")
    return OpenedLog(log_in, begin, notes, found.warnings)


def _warmed(
    summary: LogSummary, lead: ReplaySource, cfg: ReplayConfig, start_ns: int, own: OwnStages
) -> SavedState | None:
    """The state after the frames before a start; None without such frames. The frames are not written."""
    try:
        log_in = input_of(ReadableLog(summary), lead, cfg)
    except NoFrameError:
        return None
    chain, earlier = ChainState(), None
    with one_thread():
        for sample in islice(log_in.samples(), log_in.plan.first_pass.complete_frames):
            chain, _ = step(cfg, chain, sample.frame, own=own)
            earlier = sample.as_earlier
    end = log_in.end_state(with_messages=True)
    end = replace(end, from_ns=start_ns, numbers=FrameNumbers(written_from_ns=start_ns))
    saved = SavedState("", settings_of(cfg), end, ReplayState(chain, earlier))
    return decode(encode(saved), SavedState)  # as a later replay reads it


def run_of(cfg: ReplayConfig, opened: OpenedLog, target: ReplayTarget) -> dict[str, str]:
    """All inputs and options that the output of a replay depends on, by name and value."""
    plan, begin = opened.input.plan, opened.saved_for(cfg)
    return {
        **settings_of(cfg),
        "version": __version__,
        "input": plan.first_pass.digest,
        "topics": json.dumps(dict(plan.roles.topics)),
        "frames at most": str(plan.most_frames),
        "pictures": json.dumps(sorted(target.on_request)),
        "results only": str(target.results_only),
        "strict": str(plan.problems.strict_in is not None),
        "state at the beginning": "" if begin is None else hashlib.sha256(encode(begin)).hexdigest(),
    }


def finished(target: ReplayTarget, cfg: ReplayConfig, opened: OpenedLog) -> ReplaySummary | None:
    """The summary of an earlier replay whose complete output is that of this replay; None without one."""
    if not target.is_complete:
        return None
    summary = log.summarise(target.path)
    attached = {item.name: item.data for item in summary.attachments}
    recorded, begin = replay_record(summary.metadata), opened.saved_for(cfg)
    chosen = {key: topic for key, topic in recorded.items() if key.startswith(record.TOPIC_KEY)}
    is_same = (
        recorded.get(record.DIGEST_KEY) == opened.input.plan.first_pass.digest
        and recorded.get(record.VERSION_KEY) == __version__
        and chosen == opened.input.chosen_topics
        and attached.get(record.CONFIG_ATTACHMENT) == config_text(cfg, opened.input.networks).encode()
        and attached.get(record.BEGIN_ATTACHMENT) == (None if begin is None else encode(begin))
        and {(channel.topic, is_result(channel)) for channel in summary.channels} == _topics(target, opened)
    )
    if not is_same or not _are_its_tables(target, recorded, opened):
        return None
    frames = int(recorded.get(record.FRAMES_KEY, 0))
    return ReplaySummary(
        opened.input.log_id,
        frames,
        sum(summary.counts.values()),
        notes=(f"{target.path}: already complete; nothing to do",),
        warnings=opened.warnings,
        frames_before=frames,
        is_new=False,
        first_ns=opened.input.summary.first_ns or 0,
        findings=decoded_findings(recorded.get(record.FINDINGS_KEY, "")),
    )


def _are_its_tables(target: ReplayTarget, recorded: Mapping[str, str], opened: OpenedLog) -> bool:
    """Whether both tables are readable and match the input and frames of the log."""
    try:
        frames, objects = read_footer(target.metrics), read_footer(target.objects)
    except TableError:
        return False
    log_ids = {frames.facts.get(record.LOG_ID_KEY), objects.facts.get(record.LOG_ID_KEY)}
    return log_ids == {opened.input.log_id} and str(frames.rows) == recorded.get(record.FRAMES_KEY)


def _topics(target: ReplayTarget, opened: OpenedLog) -> set[tuple[str, bool]]:
    """The topics of the output, each with whether it is a result."""
    copied = () if target.results_only else opened.input.channels
    return {(topic, True) for topic in result_schemas(target.on_request)} | {(c.topic, False) for c in copied}
