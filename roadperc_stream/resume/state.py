"""The state that a replay keeps between frames, and its saved form in a result."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from roadperc_stream import log
from roadperc_stream.chain.encoding import decode, encode
from roadperc_stream.chain.step import ChainState
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import StateError
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.state import InputState
from roadperc_stream.log import LogSummary, LostSpan, Message
from roadperc_stream.model import EarlierTruth
from roadperc_stream.output.writing import Shown
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, STATE_ATTACHMENT
from roadperc_stream.system.time import TimeRange

Notes = tuple[str, ...]
_MOST_NAMED = 3
"""Settings that a message lists."""


@dataclass(frozen=True)
class ReplayState:
    """The state that a replay keeps between frames."""

    chain: ChainState = field(default_factory=ChainState)
    earlier: EarlierTruth | None = None
    shown: Shown = field(default_factory=Shown)


def packed(state: ReplayState) -> ReplayState | bytes:
    """The encoded state, which needs less memory than its images; the state itself if it is too large to encode."""
    try:
        return encode(state)
    except StateError:
        return state


@dataclass(frozen=True)
class SavedState:
    """The state after the last complete frame, saved in a result for a continued replay.

    ``log_id`` names the log of the result. ``settings`` has the JSON value of each configuration key. ``lost`` has the
    gaps of a damaged log that may affect later frames.
    """

    log_id: str
    settings: Mapping[str, str]
    input: InputState
    replay: ReplayState
    lost: tuple[LostSpan, ...] = ()

    def differences(self, cfg: ReplayConfig) -> Notes:
        """Descriptions of the settings that differ from a configuration."""
        now = settings_of(cfg)
        keys = dict.fromkeys((*self.settings, *now))
        values = ((key, self.settings.get(key, "not set"), now.get(key, "not set")) for key in keys)
        return tuple(f"{key} was {before}, is {after}" for key, before, after in values if before != after)

    def with_settings(self, cfg: ReplayConfig) -> "SavedState":
        """The state for a replay with these settings.

        With other settings the messages and the frame numbers continue, but the chain begins without a state.
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
    """The state at the end of a result, including the messages it needs.

    Raises:
        LogError: the log cannot be read.
        StateError: it has no state, or its state was saved with other settings.
    """
    summary = log.summarise(path, cfg.limits)
    state = _attached(summary, STATE_ATTACHMENT, cfg)
    if state is None:
        raise StateError(
            f"{path}: has no attachment {STATE_ATTACHMENT}: expected the result of a replay of this version"
        )
    if differing := state.differences(cfg):
        raise StateError(f"{path}: cannot be continued with other settings: {_some(differing)}")
    try:
        return replace(state, input=state.input.carrying(_inputs(summary, state)))
    except StateError as error:
        raise StateError(f"{path}: {STATE_ATTACHMENT}: {error}") from error


def state_at_begin(summary: LogSummary, cfg: ReplayConfig, part: TimeRange) -> tuple[SavedState | None, Notes]:
    """The state before the first frame of a result, and notes for the user.

    A replay with a start time begins without a state.

    Raises:
        StateError: the state cannot be read.
    """
    state = None if part.start_s is not None else _attached(summary, BEGIN_ATTACHMENT, cfg)
    if state is None or not (differing := state.differences(cfg)):
        return state, ()
    return state, (
        f"{BEGIN_ATTACHMENT}: saved with other settings ({_some(differing)}): the chain begins without a state",
    )


def _attached(summary: LogSummary, name: str, cfg: ReplayConfig) -> SavedState | None:
    found = [attachment for attachment in summary.attachments if attachment.name == name]
    if not found:
        return None
    try:
        state = decode(found[-1].data, SavedState)
        state.input.require_usable(cfg.limits)
    except StateError as error:
        raise StateError(f"{summary.path}: attachment {name}: {error}; replay its input again") from error
    return state


def _inputs(summary: LogSummary, state: SavedState) -> Iterator[Message]:
    """The messages of the log, starting with the first one that the state refers to."""
    start_ns = state.input.first_pending_ns
    if start_ns is None:
        return iter(())
    messages = log.read(summary, topics=set(state.input.topics.values()), start_ns=start_ns)
    return (message for message in messages if not is_result(message.channel))


def _some(differing: Notes) -> str:
    return ", ".join(differing[:_MOST_NAMED]) + ", ..." * (len(differing) > _MOST_NAMED)
