"""States as logs carry them: at the end of a result for the next part, and the one a result began with."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import TimeRange
from roadperc_stream.errors import StateError
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.log import Attachment, LogSummary, Message
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, STATE_ATTACHMENT
from roadperc_stream.state.bounds import StateBounds
from roadperc_stream.state.checks import require_sense
from roadperc_stream.state.encoding import decode, encode
from roadperc_stream.state.replay_state import ReplayState

Notes = tuple[str, ...]
_MEDIA_TYPE = "application/zstd"
_MOST_NAMED = 3
"""Settings that a message about them names."""


def state_at_end(path: Path, cfg: ReplayConfig) -> ReplayState:
    """The state a result ends with, with all messages that it needs.

    Raises:
        LogError: the log cannot be read.
        StateError: it carries no state, or one that this configuration cannot go on from.
    """
    summary = log.summarise(path, cfg.limits)
    state = _attached(summary, STATE_ATTACHMENT, cfg)
    if state is None:
        raise StateError(
            f"{path}: has no attachment {STATE_ATTACHMENT}: not the result of a replay, or of an older one"
        )
    if differing := state.differences(cfg):
        raise StateError(f"{path}: cannot be continued with other settings: {_some(differing)}")
    try:
        return replace(state, input=state.input.carrying(_inputs(summary, state)))
    except StateError as error:
        raise StateError(f"{path}: {STATE_ATTACHMENT}: {error}") from error


def state_at_begin(summary: LogSummary, cfg: ReplayConfig, part: TimeRange) -> tuple[ReplayState | None, Notes]:
    """The state a result began with, for whoever replays it again, and what the user should know.

    A part that does not start with the log begins by itself.

    Raises:
        StateError: the state cannot be read.
    """
    state = None if part.start_s is not None else _attached(summary, BEGIN_ATTACHMENT, cfg)
    if state is None or not (differing := state.differences(cfg)):
        return state, ()
    return state, (f"{BEGIN_ATTACHMENT}: of other settings ({_some(differing)}): the chain's memory begins anew",)


def attachment_of(name: str, state: ReplayState) -> Attachment:
    """A state as an attachment.

    Raises:
        StateError: it is too large.
    """
    return Attachment(name, _MEDIA_TYPE, encode(state))


def as_read(state: ReplayState) -> ReplayState:
    """A state as it is read back: what goes on from it now goes on as later from its bytes."""
    return decode(encode(state), ReplayState)


def _attached(summary: LogSummary, name: str, cfg: ReplayConfig) -> ReplayState | None:
    found = [attachment for attachment in summary.attachments if attachment.name == name]
    if not found:
        return None
    try:
        return require_sense(decode(found[-1].data, ReplayState, StateBounds.of(cfg.limits)), cfg)
    except StateError as error:
        raise StateError(f"{summary.path}: attachment {name}: {error}") from error


def _inputs(summary: LogSummary, state: ReplayState) -> Iterator[Message]:
    """The messages of the log from the first on that the state names."""
    start_ns = state.input.first_pending_ns
    if start_ns is None:
        return iter(())
    messages = log.read(summary, topics=set(state.input.topics.values()), start_ns=start_ns)
    return (message for message in messages if not is_result(message.channel))


def _some(differing: tuple[str, ...]) -> str:
    return ", ".join(differing[:_MOST_NAMED]) + ", ..." * (len(differing) > _MOST_NAMED)
