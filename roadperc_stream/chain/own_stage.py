"""Stages of the user's own: import them, call them, and check what they return.

The state of such a stage is kept as bytes, and decoded as its ``State`` only for a call. So a stage can change no
earlier state, a saved state is exactly the state that the next frame gets, and saving needs no type.
"""

import hashlib
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import packages_distributions, version
from pathlib import Path
from types import ModuleType, NoneType
from typing import Any, Final

from numpy import ndarray

from roadperc_stream.chain.encoding import decode_plain, encode_plain
from roadperc_stream.chain.output_checks import OUTPUTS, checked
from roadperc_stream.config import ReplayConfig, implementations
from roadperc_stream.errors import ConfigError, RoadpercError, StageError
from roadperc_stream.model import Absent, StereoDepth
from roadperc_stream.system.text import failure

_MOST_STATE_BYTES: Final = 64 * 1024**2
_NOTHING: Final = object()
_distributions = cache(packages_distributions)  # takes 0.2 s


@dataclass(frozen=True)
class OwnStage:
    """A stage of the user's own; ``name`` is ``MODULE:NAME``, ``state_type`` is ``NoneType`` without a state."""

    stage: str
    name: str
    function: Callable[..., Any]
    state_type: type[Any]

    @classmethod
    def of(cls, stage: str, code: Any, name: str = "") -> "OwnStage":
        """A stage from a class, which is called without arguments, or from another callable.

        Raises:
            ConfigError: it cannot be used as a stage.
        """
        if stage not in OUTPUTS:
            raise ConfigError(f"no stage {stage!r} to replace; expected one of {', '.join(OUTPUTS)}")
        if not name:
            home = code if hasattr(code, "__qualname__") else type(code)
            name = f"{home.__module__}:{home.__qualname__}"
        with _user_code(ConfigError, f"{stage}: {name}", name, "; see roadperc_stream/chain/protocols.py"):
            own = cls(stage, name, code() if isinstance(code, type) else code, getattr(code, "State", NoneType))
            own._require_usable()
        return own

    def _require_usable(self) -> None:
        if not callable(self.function):
            raise TypeError(f"expected a class or function, found {type(self.function).__name__}")
        parameters = getattr(self.state_type, "__dataclass_params__", None)
        if self.state_type is not NoneType and not getattr(parameters, "frozen", False):
            raise TypeError("State: expected a frozen dataclass")
        self._encoded(self.state_type())

    def step(self, place: str, cfg: Any, state: object, *inputs: Any) -> tuple[bytes, Any]:
        """Call the stage: the new state, and a checked copy of its output.

        ``place`` is the frame in words, for errors. ``state`` is not bytes before the first call.

        Raises:
            StageError: the stage raised an exception, or returned something else than its protocol says.
        """
        with self._naming(place):
            before = state if isinstance(state, bytes) else self._encoded(self.state_type())
            returned = self.function(cfg, decode_plain(before, self.state_type), *_read_only(inputs))
            if not isinstance(returned, tuple) or len(returned) != 2:
                raise TypeError(f"expected state and output, found {type(returned).__name__}")
            return self._encoded(returned[0]), checked(self.stage, returned[1], inputs[0])

    def match(self, place: str, cfg: Any, *inputs: Any) -> StereoDepth | Absent:
        """Call a stereo stage, which has no state, as ``step``."""
        with self._naming(place):
            found: StereoDepth | Absent = checked(self.stage, self.function(cfg, *_read_only(inputs)), inputs[0])
            return found

    def _naming(self, place: str) -> AbstractContextManager[None]:
        """Errors of the user's code, and of checks, name stage and frame."""
        return _user_code(StageError, f"{self.stage}: {self.name} failed in {place}", self.name)

    def _encoded(self, state: object) -> bytes:
        if type(state) is not self.state_type:
            raise TypeError(f"state: expected {self.state_type.__qualname__}, found {type(state).__name__}")
        plain = encode_plain(state, _MOST_STATE_BYTES)
        decode_plain(plain, self.state_type)  # as the next frame does
        return plain


OwnStages = Mapping[str, OwnStage]
"""The stages of the user's own, by the name of the stage."""
NO_OWN: Final[OwnStages] = {}


def own_stages(cfg: ReplayConfig) -> tuple[ReplayConfig, OwnStages]:
    """Import the own stages of a configuration of the user, never one of a log.

    Returns:
        The configuration with the version and digest of their sources, and the stages.

    Raises:
        ConfigError: a source is not the one of the configuration, the import failed, or the code is no stage.
    """
    sections, own = {}, {}
    for stage, name in implementations(cfg):
        key, section, (module_name, _, attribute) = f"{stage}.implementation", getattr(cfg, stage), name.partition(":")
        module = _imported(key, module_name)
        with _user_code(ConfigError, f"{key}: {name}", name):
            file, code = getattr(module, "__file__", None), getattr(module, attribute, _NOTHING)
        found, expected = _source(key, module_name, file), section.implementation_source
        if expected not in ("", found):
            raise ConfigError(
                f"{key}: {file} changed: found {found}, expected {expected}; "
                f"restore that source, or remove {key}_source from the configuration"
            )
        if code is _NOTHING:
            raise ConfigError(f"{key}: {file} has no {attribute!r}; expected a class or function")
        own[stage] = OwnStage.of(stage, code, name)
        sections[stage] = section.model_copy(update={"implementation_source": found})
    return cfg.model_copy(update=sections), own


def _imported(key: str, name: str) -> ModuleType:
    """A module; the working directory is searched last, so that no file there replaces an installed module."""
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    importlib.invalidate_caches()
    with _user_code(ConfigError, f"{key}: {name} cannot be imported", name):
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            if f"{name}.".startswith(f"{error.name}."):
                error.msg = f"{error.msg}; install it, or run the command in the folder of its file"
            raise


@contextmanager
def _user_code(kind: type[RoadpercError], what: str, name: str, hint: str = "") -> Iterator[None]:
    """Turn whatever the user's code raises into one error; only Ctrl-C and a lack of memory stay as they are.

    ``name`` is that of the code, whose failing line the error names.
    """
    try:
        yield
    except (KeyboardInterrupt, MemoryError):
        raise
    except BaseException as error:  # such as SystemExit
        raise kind(f"{what}: {failure(error, name)}{hint}") from error


def _source(key: str, name: str, file: object) -> str:
    """Distribution and version, if the module has them, and the digest of its file."""
    if not isinstance(file, str) or not Path(file).is_file():
        raise ConfigError(f"{key}: module {name} has no source file; name the module of the stage")
    digest = hashlib.sha256(Path(file).read_bytes()).hexdigest()
    names = sorted(set(_distributions().get(name.partition(".")[0], ())))
    return ", ".join((*(f"{name} {version(name)}" for name in names), f"sha256 {digest}"))


def _read_only(inputs: tuple[Any, ...]) -> tuple[Any, ...]:
    for array in inputs:
        if isinstance(array, ndarray):
            array.setflags(write=False)
    return inputs
