"""The state of a replay: what it keeps between frames, and how a result carries it to a continued replay."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from roadperc_stream import log
from roadperc_stream.chain.step import ChainState
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import StateError
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.state import InputState
from roadperc_stream.log import LogSummary, LostSpan, Message
from roadperc_stream.model import EarlierTruth
from roadperc_stream.output.writing import Shown
from roadperc_stream.resume.bounds import StateBounds
from roadperc_stream.resume.encoding import decode
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, STATE_ATTACHMENT
from roadperc_stream.system.time import TimeRange

Notes = tuple[str, ...]
_MOST_NAMED = 3
"""Settings that a message about them names."""


@dataclass(frozen=True)
class ReplayState:
    """What a replay keeps between frames."""

    chain: ChainState = field(default_factory=ChainState)
    earlier: EarlierTruth | None = None
    shown: Shown = field(default_factory=Shown)


@dataclass(frozen=True)
class SavedState:
    """What a result carries for a continued replay: the state after the last complete frame.

    ``log_id`` names the log of the result. ``settings`` are those of its whole configuration, the value of each key as
    JSON. ``lost`` are the gaps of a damaged log that may affect the frames still to come.
    """

    log_id: str
    settings: Mapping[str, str]
    input: InputState
    replay: ReplayState
    lost: tuple[LostSpan, ...] = ()

    def differences(self, cfg: ReplayConfig) -> Notes:
        """The settings that are not those of a configuration, in words."""
        now = settings_of(cfg)
        keys = dict.fromkeys((*self.settings, *now))
        values = ((key, self.settings.get(key, "unknown"), now.get(key, "unknown")) for key in keys)
        return tuple(f"{key} was {before}, is {after}" for key, before, after in values if before != after)

    def with_settings(self, cfg: ReplayConfig) -> "SavedState":
        """The state for a replay with these settings.

        With other settings the messages and the frame numbers continue, but the chain begins without a state: the saved
        one was made with the settings of then.
        """
        return replace(self, settings=settings_of(cfg), replay=ReplayState()) if self.differences(cfg) else self


def settings_of(cfg: ReplayConfig) -> dict[str, str]:
    """Every setting's value as JSON, by key such as ``lanes.hold_s``."""
    return {key: json.dumps(value) for key, value in _flat("", cfg.model_dump(mode="json"))}


def _flat(prefix: str, tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", value


def state_at_end(path: Path, cfg: ReplayConfig) -> SavedState:
    """The state that a result ends with, with all messages that it needs.

    Raises:
        LogError: the log cannot be read.
        StateError: it carries no state, or one that a replay with this configuration cannot continue.
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


def state_at_begin(summary: LogSummary, cfg: ReplayConfig, part: TimeRange) -> tuple[SavedState | None, Notes]:
    """The state that a result began with, to replay it again, and notes for the user.

    A part that does not start with the log begins without a state.

    Raises:
        StateError: the state cannot be read.
    """
    state = None if part.start_s is not None else _attached(summary, BEGIN_ATTACHMENT, cfg)
    if state is None or not (differing := state.differences(cfg)):
        return state, ()
    return state, (f"{BEGIN_ATTACHMENT}: of other settings ({_some(differing)}): the chain begins without a state",)


def _attached(summary: LogSummary, name: str, cfg: ReplayConfig) -> SavedState | None:
    found = [attachment for attachment in summary.attachments if attachment.name == name]
    if not found:
        return None
    try:
        state = decode(found[-1].data, SavedState, StateBounds.of(cfg.limits))
        state.input.require_usable(cfg.limits)
    except StateError as error:
        raise StateError(f"{summary.path}: attachment {name}: {error}; replay its input again") from error
    return state


def _inputs(summary: LogSummary, state: SavedState) -> Iterator[Message]:
    """The messages of the log from the first on that the state names."""
    start_ns = state.input.first_pending_ns
    if start_ns is None:
        return iter(())
    messages = log.read(summary, topics=set(state.input.topics.values()), start_ns=start_ns)
    return (message for message in messages if not is_result(message.channel))


def _some(differing: Notes) -> str:
    return ", ".join(differing[:_MOST_NAMED]) + ", ..." * (len(differing) > _MOST_NAMED)
