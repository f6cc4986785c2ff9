"""A log as what a replay goes through: its frames, and what is remembered before the first of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import UNWRITTEN
from roadperc_stream.core.threads import one_thread
from roadperc_stream.core.time import WHOLE, TimeRange, ns_to_seconds, seconds_to_ns
from roadperc_stream.errors import NoFrameError, StateError
from roadperc_stream.input import ReplayInput, input_of
from roadperc_stream.input.damage import ReadableLog, readable_log
from roadperc_stream.input.state import FrameNumbers
from roadperc_stream.log import LogSummary
from roadperc_stream.output.writing import Shown
from roadperc_stream.schemas.record import CONTINUES_KEY, FIRST_FRAME_KEY, LOG_ID_KEY
from roadperc_stream.state.attached import Notes, as_read, state_at_begin, state_at_end
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
        log_id = {LOG_ID_KEY: self.input.log_id}
        if self.begin is None or not self.begin.log_id:
            return log_id
        return {**log_id, **self.facts(), FIRST_FRAME_KEY: str(self.begin.input.numbers.next)}


@dataclass(frozen=True)
class ReplaySource:
    """What is to be replayed.

    Args:
        paths: the log, or its parts; ``-`` is standard input.
        overrides: topic of each role that is not on the contract's topic.
        part: of the log.
        recover: replay what can be read of a damaged log.
        strict: the first message that cannot be used is an error.
    """

    paths: Path | Sequence[Path]
    overrides: Mapping[str, str] = field(default_factory=dict)
    part: TimeRange = WHOLE
    recover: bool = False
    strict: bool = False

    def read(self, cfg: ReplayConfig) -> ReadableLog:
        """The log, as far as it can be read.

        Raises:
            LogError: it cannot, or is damaged where that is an error.
        """
        return readable_log(self.paths, cfg.limits, self.part, recover=self.recover)

    def opened(
        self, found: ReadableLog, cfg: ReplayConfig, begin: ReplayState | None, notes: Notes = ()
    ) -> "OpenedLog":
        """The log as what a replay goes through, once it is known what came before.

        Raises:
            ChannelError: the channels do not fit the roles.
            LogError: it is damaged in the part asked for, or that holds no frame.
        """
        part, state = found.part(self.part), None if begin is None else begin.input
        log_in = input_of(found.summary, cfg, self.overrides, part, state, strict=self.strict)
        if not self.recover:
            found.require_outside(*log_in.plan.window.limits_ns)
        return OpenedLog(log_in, begin, notes, found.warnings, self.strict)


def open_log(source: ReplaySource, cfg: ReplayConfig) -> OpenedLog:
    """Open a log, to begin as its own recording does: where a replay wrote it, with the state that replay began with.

    Raises:
        ChannelError: the channels do not fit the roles.
        LogError: the log cannot be read, is damaged, or the part asked for holds no frame.
        StateError: the state it carries cannot be read.
    """
    found = source.read(cfg)
    return source.opened(found, cfg, *state_at_begin(found.summary, cfg, source.part))


def open_continued(source: ReplaySource, cfg: ReplayConfig, before: Path) -> OpenedLog:
    """Open a part of a drive, to go on from the result of the part before.

    Raises:
        StateError: it cannot go on from there; else as ``open_log``.
    """
    begin = state_at_end(before, cfg)
    opened = source.opened(source.read(cfg), cfg, begin)
    summary, starts_ns, ended_ns = opened.input.summary, opened.input.span_ns[0], begin.input.from_ns
    if summary.first_ns is not None and starts_ns < ended_ns:
        lead_s = ns_to_seconds(ended_ns - starts_ns)
        raise StateError(
            f"{summary.path}: begins {lead_s:.3f} s before the end of what {before} holds: expected what "
            "follows; give the part that does, or where it begins in this file with --start"
        )
    return opened


def open_warmed(source: ReplaySource, cfg: ReplayConfig, warm_up_s: float) -> OpenedLog:
    """Open a part of a log, the chain's memory built on the seconds before it.

    Raises:
        as ``open_log``.
    """
    found = source.read(cfg)
    start_s = found.part(source.part).start_s or 0.0
    short = (f"warm-up: {start_s:g} s, the log has no more before the start",) if start_s < warm_up_s else ()
    lead = TimeRange(start_s - warm_up_s, start_s)
    begin = _warmed(found.summary, cfg, source.overrides, lead) if start_s > 0 else None
    return source.opened(found, cfg, begin, short)


def _warmed(
    summary: LogSummary, cfg: ReplayConfig, overrides: Mapping[str, str], lead: TimeRange
) -> ReplayState | None:
    """What is remembered of the frames before a start, none of which is written; None where there are none."""
    try:
        log_in = input_of(summary, cfg, overrides, lead)
    except NoFrameError:
        return None
    memory = ReplayMemory(is_warming=True)
    with one_thread():
        for sample in islice(log_in.samples(), log_in.plan.first_pass.complete_frames):
            memory, *_ = run_frame(cfg, memory, "", replace(sample, index=UNWRITTEN))
    end = log_in.end_state(with_messages=True)
    start_ns = (summary.first_ns or 0) + seconds_to_ns(lead.end_s or 0.0)
    end = replace(end, from_ns=start_ns, numbers=FrameNumbers(written_from_ns=start_ns))
    return as_read(ReplayState("", settings_of(cfg), end, replace(memory, shown=Shown())))
