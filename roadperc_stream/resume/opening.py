"""Opens a log for a replay: its frames, the state before the first one, and whether its output is already complete."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from roadperc_stream import __version__, log
from roadperc_stream.chain.encoding import encode
from roadperc_stream.chain.own_stage import OwnStages
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ConfigError, StateError, TableError
from roadperc_stream.input import ReplayInput, ReplaySource, input_of
from roadperc_stream.input.earlier_replay import is_result, replay_record
from roadperc_stream.input.window import LeadIn
from roadperc_stream.log import DIGEST_ALGORITHM
from roadperc_stream.model.finding import decoded_findings
from roadperc_stream.output.tables import config_text, read_footer
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import ReplaySummary
from roadperc_stream.resume.state import EndState, Notes, ReplayState, SavedState, settings_of, state_at_end
from roadperc_stream.schemas import record
from roadperc_stream.schemas.topics import result_schemas
from roadperc_stream.system.text import whole_number
from roadperc_stream.system.time import ns_to_seconds, seconds_to_ns


@dataclass(frozen=True)
class OpenedLog:
    """The input of a replay, and the state that it begins with.

    ``continued_log_id`` names the log of a continued result, ``warm_up_s`` is the length of a warm-up. A result with
    either cannot be repeated from its own messages.
    """

    input: ReplayInput
    initial: ReplayState = field(default_factory=ReplayState)
    continued_log_id: str = ""
    warm_up_s: float = 0.0
    notes: Notes = ()
    warnings: tuple[str, ...] = ()
    """Warnings about a damaged log."""

    def end_state(self) -> EndState:
        """The state for a later log, before the first frame."""
        lead = self.input.plan.lead
        last = None if lead is None else lead.last
        saved = SavedState(self.input.log_id, settings_of(self.input.cfg), self.initial, last)
        return EndState(saved, StateError("no frame is complete") if self.warm_up_s else None)

    def facts(self) -> dict[str, str]:
        """How the replay begins, for the output to record."""
        if self.continued_log_id:
            state = hashlib.sha256(encode(self.initial)).hexdigest()
            return {record.CONTINUES_KEY: self.continued_log_id, record.STATE_KEY: state}
        return {record.WARM_UP_KEY: repr(self.warm_up_s)} if self.warm_up_s else {}

    def table_facts(self) -> dict[str, str]:
        """The log facts for the tables, and the number of a continued replay's first frame."""
        log_id = {record.LOG_ID_KEY: self.input.log_id, record.DIGEST_ALGORITHM_KEY: DIGEST_ALGORITHM}
        lead = self.input.plan.lead
        if lead is None or not lead.continues:
            return log_id
        first = 0 if lead.last is None else lead.last.number + 1
        return {**log_id, **self.facts(), record.FIRST_FRAME_KEY: str(first)}


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
    return _open_warmed(source, cfg, warm_up_s) if warm_up_s else open_log(source, cfg)


def open_log(source: ReplaySource, cfg: ReplayConfig) -> OpenedLog:
    """Open a log. The replay begins without a state.

    Raises:
        ChannelError: the channels do not fit the roles.
        LogError: the log cannot be read, is damaged, or the requested part has no frame.
    """
    found = source.read(cfg.limits)
    recorded = replay_record(found.summary.metadata)
    origins = {record.CONTINUES_KEY: "continues another result", record.WARM_UP_KEY: "began with a warm-up"}
    notes = (
        f"{found.summary.path}: this result {words}; this replay begins without its state, so the results differ"
        for key, words in origins.items()
        if key in recorded and source.time_range.start_s is None
    )
    return OpenedLog(input_of(found, source, cfg), notes=tuple(notes), warnings=found.warnings)


def _open_continued(source: ReplaySource, cfg: ReplayConfig, before: Path) -> OpenedLog:
    """Open a log that continues an earlier result, whose last messages are read again.

    Raises:
        StateError: the log does not follow the result; else as ``open_log``.
    """
    earlier = log.summarise(before, cfg.limits)
    saved = state_at_end(earlier, cfg)
    cut_ns = whole_number(replay_record(earlier.metadata).get(record.END_KEY, ""))
    ended_ns = (earlier.last_ns or 0) if cut_ns is None else cut_ns
    lead = LeadIn(
        earlier,
        0 if saved.last is None else saved.last.since_ns,
        ended_ns + 1 if cut_ns is None else ended_ns,
        continues=True,
        last=saved.last,
    )
    found = source.read(cfg.limits)
    log_in = input_of(found, source, cfg, lead)
    summary, starts_ns = log_in.summary, log_in.span_ns[0]
    if summary.first_ns is not None and starts_ns < ended_ns:
        lead_s, start_s = ns_to_seconds(ended_ns - starts_ns), ns_to_seconds(lead.end_ns - summary.first_ns)
        raise StateError(
            f"{summary.path}: begins {lead_s:.3f} s before the end of {before}: expected later messages; "
            f"pass --start {start_s:.9f} to skip the overlap, or pass all files of the log together"
        )
    return OpenedLog(log_in, saved.replay, saved.log_id, warnings=found.warnings)


def _open_warmed(source: ReplaySource, cfg: ReplayConfig, warm_up_s: float) -> OpenedLog:
    """Open a part of a log whose earlier seconds build the state first.

    Raises:
        LogError: these seconds are damaged, which would change the state; else as ``open_log``.
    """
    found = source.read(cfg.limits)
    start_s, first_ns = found.part(source.time_range).start_s or 0.0, found.summary.first_ns or 0
    short = (f"warm-up: {start_s:g} s; the log has no more before the start",) if start_s < warm_up_s else ()
    begins_ns, start_ns = (first_ns + seconds_to_ns(time_s) for time_s in (start_s - warm_up_s, start_s))
    lead = LeadIn(found.summary, max(begins_ns, 0), start_ns, continues=False) if start_s > 0 else None
    return OpenedLog(input_of(found, source, cfg, lead), warm_up_s=warm_up_s, notes=short, warnings=found.warnings)


def run_of(opened: OpenedLog, target: ReplayTarget) -> dict[str, str]:
    """All inputs and options that the output of a replay depends on, by name and value."""
    plan = opened.input.plan
    return {
        **settings_of(opened.input.cfg),
        "version": __version__,
        "input": plan.first.digest.hexdigest(),
        "topics": json.dumps(dict(plan.roles.topics)),
        "frames at most": str(plan.most_frames),
        "pictures": json.dumps(sorted(target.on_request)),
        "results only": str(target.results_only),
        "strict": str(plan.problems.strict_in is not None),
        "beginning": json.dumps(opened.facts()),
    }


def finished(target: ReplayTarget, opened: OpenedLog) -> ReplaySummary | None:
    """The summary of an earlier replay whose complete output is that of this replay; None without one.

    For a strict replay, the output of one that was not strict is complete too.
    """
    if not target.is_complete:
        return None
    summary = log.summarise(target.path)
    attached = {item.name: item.data for item in summary.attachments}
    recorded = replay_record(summary.metadata)
    chosen = {key: topic for key, topic in recorded.items() if key.startswith(record.TOPIC_KEY)}
    is_same = (
        recorded.get(record.DIGEST_KEY) == opened.input.plan.first.digest.hexdigest()
        and recorded.get(record.VERSION_KEY) == __version__
        and chosen == opened.input.chosen_topics
        and attached.get(record.CONFIG_ATTACHMENT) == config_text(opened.input.cfg, opened.input.networks).encode()
        and {
            key: recorded[key]
            for key in (record.CONTINUES_KEY, record.STATE_KEY, record.WARM_UP_KEY)
            if key in recorded
        }
        == opened.facts()
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
