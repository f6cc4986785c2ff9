"""Runs the stages of a frame: enabled or not, timed, built-in or of the user's own."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeVar

from roadperc_stream.chain.own_stage import OwnStage, OwnStages
from roadperc_stream.chain.stages import stereo
from roadperc_stream.config import BUILT_IN, ReplayConfig
from roadperc_stream.errors import ConfigError, StateError
from roadperc_stream.model import Absent, Frame, Reason
from roadperc_stream.model.results import StereoDepth

T = TypeVar("T")
U = TypeVar("U")
Timer = Callable[[str], AbstractContextManager[object]]
"""Called with a stage's name; the context it returns is active while the stage runs."""


@dataclass(frozen=True)
class Stages:
    """Runs the enabled stages on a frame, each timed under its name; ``own`` ones replace built-in ones."""

    cfg: ReplayConfig
    timer: Timer
    own: OwnStages
    frame: Frame

    def run(self, stage: str, compute: Callable[[], T], otherwise: U) -> T | U:
        """The result of ``compute``, or ``otherwise`` if the stage is switched off."""
        if not getattr(self.cfg, stage).enabled:
            return otherwise
        with self.timer(stage):
            return compute()

    def step(
        self, stage: str, built_in: Callable[..., tuple[Any, T]], state: Any, *inputs: Any
    ) -> tuple[Any, T | Absent]:
        """The new state and the output of a stage; the same state if the stage is switched off."""
        section = getattr(self.cfg, stage)
        if not section.enabled:
            return state, off(stage)
        with self.timer(stage):
            if replacement := self._own(stage):
                return replacement.step(self._place, section, state, *inputs)
            if isinstance(state, bytes):
                raise StateError(f"{stage}: its state is that of an own stage; replay the input from the start")
            return built_in(section, state, *inputs)

    def match(self, *pair: Any) -> StereoDepth | Absent:
        """Depth of a stereo pair; ``pair`` are the inputs of the stage."""
        replacement, cfg = self._own("stereo"), self.cfg.stereo
        return replacement.match(self._place, cfg, *pair) if replacement else stereo.match(cfg, *pair)

    def _own(self, stage: str) -> OwnStage | None:
        """The stage of the user's own; None for the built-in one."""
        name = getattr(self.cfg, stage).implementation
        if stage not in self.own and name != BUILT_IN:
            raise ConfigError(f"{stage}.implementation: {name} is not loaded; only settings of the user import code")
        return self.own.get(stage)

    @property
    def _place(self) -> str:
        stamp = f"stamp {self.frame.stamp_ns} ns"
        return f"the frame with {stamp}" if self.frame.number is None else f"frame {self.frame.number} ({stamp})"


def needs_scene(cfg: ReplayConfig) -> bool:
    """Whether an enabled stage uses depth or tags: any stage except stereo."""
    return any(stage.enabled for stage in (cfg.surface, cfg.odometry, cfg.lanes, cfg.objects, cfg.occupancy))


def off(stage: str) -> Absent:
    """The output of a stage that is switched off."""
    return Absent(Reason(stage, "switched_off"))
