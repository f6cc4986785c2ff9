"""A log as what a replay goes through: its frames, and what is remembered before the first of them."""

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Final

from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import UNWRITTEN
from roadperc_stream.core.threads import one_thread
from roadperc_stream.core.time import TimeRange, ns_to_seconds, seconds_to_ns
from roadperc_stream.errors import ConfigError, NoFrameError, StateError
from roadperc_stream.input import ReplayInput, ReplaySource, input_of
from roadperc_stream.input.damage import ReadableLog
from roadperc_stream.input.state import FrameNumbers
from roadperc_stream.log import DIGEST_ALGORITHM, LogSummary
from roadperc_stream.output.writing import Shown
from roadperc_stream.schemas.record import CONTINUES_KEY, DIGEST_ALGORITHM_KEY, FIRST_FRAME_KEY, LOG_ID_KEY
from roadperc_stream.state.attached import Notes, as_read, state_at_begin, state_at_end
from roadperc_stream.state.checks import require_numbers_for
from roadperc_stream.state.replay_state import ReplayMemory, ReplayState, settings_of
from roadperc_stream.state.running import run_frame


@dataclass(frozen=True)
class OpenedLog:
    """The input of a replay, and the state it begins with; None where nothing came before."""

    input: ReplayInput
    begin: ReplayState | None = None
    notes: Notes = ()
    warnings: tuple[str, ...] = ()
    """What the user should know of a damaged log."""
    strict: bool = False
    """Whether a message that cannot be used is an error."""

    def state_for(self, cfg: ReplayConfig) -> ReplayState | None:
        """The state that a replay with these settings begins with."""
        return None if self.begin is None else self.begin.with_settings(cfg)

    def memory_for(self, cfg: ReplayConfig) -> ReplayMemory:
        """What a replay with these settings remembers before the first frame."""
        state = self.state_for(cfg)
        return ReplayMemory() if state is None else state.memory

    def facts(self) -> dict[str, str]:
        """Which part of the drive it goes on from, for the output to say."""
        return {CONTINUES_KEY: self.begin.log_id} if self.begin is not None and self.begin.log_id else {}

    def table_facts(self) -> dict[str, str]:
        """What the tables say of the log, and where it goes on from another part the number of the first frame."""
        log_id = {LOG_ID_KEY: self.input.log_id, DIGEST_ALGORITHM_KEY: DIGEST_ALGORITHM}
        if self.begin is None or not self.begin.log_id:
            return log_id
        return {**log_id, **self.facts(), FIRST_FRAME_KEY: str(self.begin.input.numbers.next)}


@dataclass(frozen=True)
class Beginning:
    """What the chain has seen before the first frame that is written; nothing unless said.

    Args:
        continued: the result of the part of the drive before, to go on from.
        warm_up_s: seconds of log before the start of the part to replay, of which nothing is written.
    """

    continued: Path | None = None
    warm_up_s: float = 0.0


BY_ITSELF: Final = Beginning()


def open_replay(source: ReplaySource, cfg: ReplayConfig, beginning: Beginning) -> OpenedLog:
    """Open a log, to begin as is asked for.

    Raises:
        ConfigError: two beginnings are asked for, or a warm-up without a start; else as ``open_log``.
    """
    if beginning.warm_up_s and beginning.continued is not None:
        raise ConfigError("warm_up_s: what is continued needs no warm-up")
    if beginning.warm_up_s and source.time_range.start_s is None:
        raise ConfigError("warm_up_s: only with a start")
    if beginning.continued is not None:
        return _open_continued(source, cfg, beginning.continued)
    if beginning.warm_up_s:
        return _open_warmed(source, cfg, beginning.warm_up_s)
    return open_log(source, cfg)


def open_log(source: ReplaySource, cfg: ReplayConfig) -> OpenedLog:
    """Open a log, to begin as its own recording does: where a replay wrote it, with the state that replay began with.

    Raises:
        ChannelError: the channels do not fit the roles.
        LogError: the log cannot be read, is damaged, or the part asked for holds no frame.
        StateError: the state it carries cannot be read.
    """
    found = source.read(cfg.limits)
    return _opened(found, source, cfg, *state_at_begin(found.summary, cfg, source.time_range))


def _open_continued(source: ReplaySource, cfg: ReplayConfig, before: Path) -> OpenedLog:
    """Open a part of a drive, to go on from the result of the part before.

    Raises:
        StateError: it cannot go on from there; else as ``open_log``.
    """
    begin = state_at_end(before, cfg)
    opened = _opened(source.read(cfg.limits), source, cfg, begin)
    summary, starts_ns, ended_ns = opened.input.summary, opened.input.span_ns[0], begin.input.from_ns
    if summary.first_ns is not None and starts_ns < ended_ns:
        lead_s, start_s = ns_to_seconds(ended_ns - starts_ns), ns_to_seconds(begin.input.next_ns - summary.first_ns)
        raise StateError(
            f"{summary.path}: begins {lead_s:.3f} s before the end of what {before} holds: expected what follows; "
            f"--start {start_s:.9f} leaves out what it holds, and parts that are given together may overlap"
        )
    return opened


def _open_warmed(source: ReplaySource, cfg: ReplayConfig, warm_up_s: float) -> OpenedLog:
    """Open a part of a log, the chain's memory built on the seconds before it."""
    found = source.read(cfg.limits)
    start_s = found.part(source.time_range).start_s or 0.0
    short = (f"warm-up: {start_s:g} s, the log has no more before the start",) if start_s < warm_up_s else ()
    lead = replace(source, time_range=TimeRange(start_s - warm_up_s, start_s))
    if not source.recover:
        _require_sound_lead(found, lead.time_range)
    begin = _warmed(found.summary, lead, cfg) if start_s > 0 else None
    return _opened(found, source, cfg, begin, short)


def _opened(
    found: ReadableLog, source: ReplaySource, cfg: ReplayConfig, begin: ReplayState | None, notes: Notes = ()
) -> OpenedLog:
    """A log as what a replay goes through, once it is known what came before."""
    if begin is None:
        return OpenedLog(input_of(found, source, cfg), begin, notes, found.warnings, source.strict)
    log_in = input_of(found, source, cfg, begin.input, begin.lost)
    require_numbers_for(begin, log_in.expected_frames)
    return OpenedLog(log_in, begin, notes, found.warnings, source.strict)


def _require_sound_lead(found: ReadableLog, lead: TimeRange) -> None:
    """Check that nothing is damaged in the seconds before a start: the memory they build would be another one.

    Raises:
        LogError: something is.
    """
    first_ns = found.summary.first_ns or 0
    start_ns, end_ns = (first_ns + seconds_to_ns(limit_s or 0.0) for limit_s in (lead.start_s, lead.end_s))
    found.require_outside(start_ns, end_ns)


def _warmed(summary: LogSummary, lead: ReplaySource, cfg: ReplayConfig) -> ReplayState | None:
    """What is remembered of the frames before a start, none of which is written; None where there are none."""
    try:
        log_in = input_of(ReadableLog(summary), lead, cfg)
    except NoFrameError:
        return None
    memory = ReplayMemory(is_warming=True)
    with one_thread():
        for sample in islice(log_in.samples(), log_in.plan.first_pass.complete_frames):
            memory, *_ = run_frame(cfg, memory, "", replace(sample, index=UNWRITTEN))
    end = log_in.end_state(with_messages=True)
    start_ns = (summary.first_ns or 0) + seconds_to_ns(lead.time_range.end_s or 0.0)
    end = replace(end, from_ns=start_ns, numbers=FrameNumbers(written_from_ns=start_ns))
    return as_read(ReplayState("", settings_of(cfg), end, replace(memory, shown=Shown())))
