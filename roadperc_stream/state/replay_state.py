"""Everything a replay must remember to go on, from one frame to the next and from one part of a drive to the next."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from roadperc_stream.chain.step import ChainState
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import EarlierTruth
from roadperc_stream.input.state import InputState
from roadperc_stream.log import LostSpan
from roadperc_stream.output.writing import Shown


@dataclass(frozen=True)
class ReplayMemory:
    """What is remembered from one frame to the next.

    ``is_warming`` says that no frame has been written yet: the frames so far only warmed up the chain.
    """

    chain: ChainState = field(default_factory=ChainState)
    earlier: EarlierTruth | None = None
    shown: Shown = field(default_factory=Shown)
    is_warming: bool = False


@dataclass(frozen=True)
class ReplayState:
    """What is remembered from one part of a drive to the next, as it is after the last frame that was complete.

    ``log_id`` names the part before, ``settings`` are those of the whole configuration it was replayed with: their
    values as JSON, by key. ``lost`` are the gaps of a damaged log that the frames still to come may lie in.
    """

    log_id: str
    settings: Mapping[str, str]
    input: InputState
    memory: ReplayMemory
    lost: tuple[LostSpan, ...] = ()

    def differences(self, cfg: ReplayConfig) -> tuple[str, ...]:
        """The settings that are not those of a configuration, in words."""
        now = settings_of(cfg)
        keys = dict.fromkeys((*self.settings, *now))
        values = ((key, self.settings.get(key, "unknown"), now.get(key, "unknown")) for key in keys)
        return tuple(f"{key} was {before}, is {after}" for key, before, after in values if before != after)

    def with_settings(self, cfg: ReplayConfig) -> "ReplayState":
        """The state for a replay with these settings.

        With other ones the messages and the frames' numbers go on as they did, but the chain remembers nothing: what it
        remembered was made with the settings of then.
        """
        if not self.differences(cfg):
            return self
        return replace(self, settings=settings_of(cfg), memory=ReplayMemory(is_warming=self.memory.is_warming))


def settings_of(cfg: ReplayConfig) -> dict[str, str]:
    """Every setting's value as JSON, by key such as ``lanes.hold_s``."""
    return {key: json.dumps(value) for key, value in _flat("", cfg.model_dump(mode="json"))}


def _flat(prefix: str, tree: Mapping[str, Any]) -> list[tuple[str, Any]]:
    items: list[tuple[str, Any]] = []
    for key, value in tree.items():
        items += _flat(f"{prefix}{key}.", value) if isinstance(value, dict) else [(f"{prefix}{key}", value)]
    return items
