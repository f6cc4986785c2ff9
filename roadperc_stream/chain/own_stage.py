"""Stages of the user's own: load them, call them, and check what they return.

The state of such a stage is kept as bytes. So a stage can change no earlier state, a saved state is exactly the state
that the next frame gets, and saving needs no type. It is decoded as the stage's ``State`` only for the call.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final

from numpy import ndarray

from roadperc_stream.chain.encoding import decode_plain, encode_plain
from roadperc_stream.chain.output_checks import OUTPUTS, checked
from roadperc_stream.config import ReplayConfig, implementations, with_sources
from roadperc_stream.errors import ConfigError, StageError
from roadperc_stream.system.text import failure

_MOST_STATE_BYTES: Final = 64 * 1024**2
_SIGNATURES: Final = "see roadperc_stream/chain/protocols.py for the signature"
Place = str
"""The frame of a call, in words, such as ``frame 12 (stamp 600000000 ns)``."""


@dataclass(frozen=True)
class OwnStage:
    """A stage of the user's own: its name, source file and function, and its ``State``, None without one."""

    stage: str
    name: str
    file: str
    function: Callable[..., Any]
    state_type: type[Any] | None
    first: bytes
    """The state before the first frame."""

    @classmethod
    def of(cls, stage: str, code: Any, name: str = "") -> "OwnStage":
        """A stage from a class, which is called without arguments, or from another callable.

        Raises:
            ConfigError: it cannot be used as a stage.
        """
        home = code if hasattr(code, "__qualname__") else type(code)
        name = name or f"{home.__module__}:{getattr(home, '__qualname__', '')}"
        file = getattr(sys.modules.get(home.__module__), "__file__", None) or ""
        if stage not in OUTPUTS:
            raise ConfigError(f"no stage {stage!r} to replace; expected one of {', '.join(OUTPUTS)}")
        try:
            function = code() if isinstance(code, type) else code
        except (Exception, SystemExit) as error:  # code of the user can fail in any way
            raise ConfigError(f"{stage}: {name}() failed: {failure(error, file)}") from error
        if not callable(function):
            raise ConfigError(
                f"{stage}: {name}: expected a class or function, found {_described(function)}; {_SIGNATURES}"
            )
        state_type = getattr(code, "State", None)
        if state_type is not None and stage == "stereo":
            raise ConfigError(f"{stage}: {name}: State: stereo has no state")
        first = b"" if state_type is None else _first_state(f"{stage}: {name}", state_type, file)
        return cls(stage, name, file, function, state_type, first)

    def step(self, place: Place, cfg: Any, state: object, *inputs: Any) -> tuple[bytes, Any]:
        """Call the stage and check what it returns.

        Args:
            place: the frame, for errors.
            cfg: the stage's settings.
            state: from the last call; no bytes for the first call.
            *inputs: as in the stage's protocol.

        Returns:
            The new state and a copy of the output.

        Raises:
            StageError: the stage raised an exception, or returned something else than its protocol says.
        """
        before = self._decoded(place, state if isinstance(state, bytes) else self.first)
        returned = self._call(place, cfg, before, *inputs)
        if not isinstance(returned, tuple) or len(returned) != 2:
            raise self._wrong(place, f"expected state and output, found {_described(returned)}")
        return self._encoded(place, returned[0]), self._checked(place, returned[1], inputs[0])

    def match(self, place: Place, cfg: Any, *inputs: Any) -> Any:
        """Call a stage without state, as ``step``."""
        return self._checked(place, self._call(place, cfg, *inputs), inputs[0])

    def _call(self, place: Place, *arguments: Any) -> Any:
        for array in (item for item in arguments if isinstance(item, ndarray)):
            array.setflags(write=False)
        try:
            return self.function(*arguments)
        except MemoryError:
            raise
        except (Exception, SystemExit) as error:  # code of the user can fail in any way
            raise StageError(f"{self.stage}: {self.name} failed in {place}: {failure(error, self.file)}") from error

    def _checked(self, place: Place, output: object, seen: Any) -> Any:
        try:
            return checked(self.stage, output, seen)
        except ValueError as error:
            raise self._wrong(place, str(error)) from error

    def _decoded(self, place: Place, state: bytes) -> Any:
        if self.state_type is None:
            return None
        try:
            return decode_plain(state, self.state_type)
        except Exception as error:  # the state's own checks can fail in any way
            raise self._wrong(place, f"its saved state: {failure(error, self.file)}") from error

    def _encoded(self, place: Place, state: object) -> bytes:
        if type(state) is not (self.state_type or type(None)):
            expected = "None" if self.state_type is None else self.state_type.__qualname__
            raise self._wrong(place, f"state: expected {expected}, found {_described(state)}")
        try:
            plain = b"" if state is None else encode_plain(state, _MOST_STATE_BYTES)
        except Exception as error:  # a value can have no encoding
            raise self._wrong(place, f"state: {failure(error, self.file)}") from error
        self._decoded(place, plain)
        return plain

    def _wrong(self, place: Place, fault: str) -> StageError:
        return StageError(f"{self.stage}: {self.name} in {place}: {fault}; {_SIGNATURES}")


OwnStages = Mapping[str, OwnStage]
"""The stages of the user's own, by the name of the stage."""
NO_OWN_STAGES: Final[OwnStages] = {}


def own_stages(cfg: ReplayConfig) -> OwnStages:
    """Import the own stages of a configuration. Call it only for configurations of the user, never of a log.

    Raises:
        ConfigError: the source changed, the import failed, or the code cannot be used as a stage.
    """
    with_sources(cfg)
    return {stage: OwnStage.of(stage, _imported(stage, name), name) for stage, name in implementations(cfg)}


def _imported(stage: str, name: str) -> Any:
    key, (module_name, _, attribute) = f"{stage}.implementation", name.partition(":")
    spec = find_spec(module_name)
    try:
        module = import_module(module_name)
    except (Exception, SystemExit) as error:  # code of the user can fail in any way
        file = str(spec and spec.origin)
        raise ConfigError(f"{key}: {module_name} cannot be imported: {failure(error, file)}") from error
    if not hasattr(module, attribute):
        raise ConfigError(f"{key}: {module.__file__} has no {attribute!r}; expected a class or function")
    return getattr(module, attribute)


def _first_state(owner: str, state_type: Any, file: str) -> bytes:
    """The encoded state before the first frame.

    Raises:
        ConfigError: the class cannot be a state.
    """
    is_frozen = getattr(getattr(state_type, "__dataclass_params__", None), "frozen", False)
    if not isinstance(state_type, type) or not is_frozen:
        raise ConfigError(f"{owner}: State: expected a frozen dataclass")
    try:
        first = encode_plain(state_type(), _MOST_STATE_BYTES)
        decode_plain(first, state_type)
    except Exception as error:  # the state's own checks can fail in any way
        fault = f"{failure(error, file)}; expected a default for each field, and types with an encoding"
        raise ConfigError(f"{owner}: State: {fault}") from error
    return first


def _described(value: object) -> str:
    return "None" if value is None else type(value).__name__
