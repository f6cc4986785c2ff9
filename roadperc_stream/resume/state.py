"""The state that a replay keeps between frames, and its saved form in a result."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from roadperc_stream.chain.encoding import decode, encode
from roadperc_stream.chain.step import State
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import StateError
from roadperc_stream.log import Attachment, LogSummary
from roadperc_stream.model import EarlierTruth, SettledFrame
from roadperc_stream.output.writing import Shown
from roadperc_stream.schemas.record import STATE_ATTACHMENT

Notes = tuple[str, ...]
_MEDIA_TYPE: Final = "application/zstd"
_MOST_NAMED: Final = 3
"""Settings that a message lists."""


@dataclass(frozen=True)
class ReplayState:
    """The state that a replay keeps between frames."""

    chain: State = field(default_factory=State)
    earlier: EarlierTruth | None = None
    shown: Shown = field(default_factory=Shown)


@dataclass(frozen=True)
class SavedState:
    """The state after the last complete frame, saved in a result for a continued replay.

    ``log_id`` names the log of the result. ``settings`` has the JSON value of each configuration key. ``last`` is None
    if no frame is complete.
    """

    log_id: str
    settings: Mapping[str, str]
    replay: ReplayState = field(default_factory=ReplayState)
    last: SettledFrame | None = None

    def differences(self, cfg: ReplayConfig) -> Notes:
        """Descriptions of the settings that differ from a configuration."""
        now = settings_of(cfg)
        keys = dict.fromkeys((*self.settings, *now))
        values = ((key, self.settings.get(key, "not set"), now.get(key, "not set")) for key in keys)
        return tuple(f"{key} was {before}, is {after}" for key, before, after in values if before != after)


class EndState:
    """The state that a result ends with: that after its last complete frame.

    It is encoded at the first frame that is not complete, because its bytes need less memory than its images.
    """

    def __init__(self, saved: SavedState, error: StateError | None = None) -> None:
        """Begin with the state of a replay without a complete frame; ``error`` if it cannot be continued."""
        self._saved, self._encoded, self._error = saved, b"", error

    def reached(self, last: SettledFrame | None, state: ReplayState) -> None:
        """Take the state after one more frame, which is ``last`` if it is complete."""
        if last is not None:
            self._saved, self._encoded, self._error = replace(self._saved, replay=state, last=last), b"", None
        elif not self._encoded and self._error is None:
            self._encode()

    def attached(self) -> tuple[tuple[Attachment, ...], Notes]:
        """The attachment with the state, and notes for the user."""
        if not self._encoded and self._error is None:
            self._encode()
        if self._error is not None:  # the results do not depend on it
            return (), (f"{STATE_ATTACHMENT}: left out, this result cannot be continued: {self._error}",)
        return (Attachment(STATE_ATTACHMENT, _MEDIA_TYPE, self._encoded),), ()

    def _encode(self) -> None:
        try:
            self._encoded = encode(self._saved)
        except StateError as error:
            self._error = error
        else:
            self._saved = replace(self._saved, replay=ReplayState())


def settings_of(cfg: ReplayConfig) -> dict[str, str]:
    """Every setting's value as JSON, by key such as ``lanes.hold_s``."""
    return {key: json.dumps(value) for key, value in _flat("", cfg.model_dump(mode="json"))}


def _flat(prefix: str, tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", value


def state_at_end(summary: LogSummary, cfg: ReplayConfig) -> SavedState:
    """The state at the end of a result.

    Raises:
        StateError: it has no state, or its state was saved with other settings.
    """
    path = summary.path
    found = [attachment for attachment in summary.attachments if attachment.name == STATE_ATTACHMENT]
    if not found:
        raise StateError(
            f"{path}: has no attachment {STATE_ATTACHMENT}: expected the result of a replay of this version, "
            "with its input (not --results-only)"
        )
    try:
        state = decode(found[-1].data, SavedState)
    except StateError as error:
        raise StateError(f"{path}: attachment {STATE_ATTACHMENT}: {error}; replay its input again") from error
    if differing := state.differences(cfg):
        named = ", ".join(differing[:_MOST_NAMED]) + ", ..." * (len(differing) > _MOST_NAMED)
        raise StateError(f"{path}: cannot be continued with other settings: {named}")
    return state
