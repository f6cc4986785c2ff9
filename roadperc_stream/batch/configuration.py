"""What a batch does with every log: settings and options, and the short name of both."""

import hashlib
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Final

import tomli_w

import roadperc_stream
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import WHOLE, TimeRange

_DIGITS: Final = 8
_FOLDERS: Final = ("chain", "core", "formats", "input", "log", "metrics", "output", "schemas", "state")
_RESULTS_DEPEND_ON: Final = ("*.py", "batch/*join*.py", "batch/split*.py", *(f"{name}/**/*.py" for name in _FOLDERS))
_LIBRARIES: Final = ("numpy", "opencv-python-headless", "scipy")


@dataclass(frozen=True)
class BatchConfiguration:
    """Everything but the log that results depend on.

    Args:
        cfg: the chain's configuration.
        topics: role and topic, where logs have topics of their own.
        time_range: the part of every log to replay.
        split_s: replay parts of so many seconds at once; None: each log in one pass.
        warm_up_s: seconds of log that the chain sees before each of these parts.
    """

    cfg: ReplayConfig
    topics: tuple[tuple[str, str], ...] = ()
    time_range: TimeRange = WHOLE
    split_s: float | None = None
    warm_up_s: float = 0.0

    @cached_property
    def name(self) -> str:
        """Eight hexadecimal digits, from what is not the default: a new setting leaves the names as they are."""
        return _digest(f"{self.settings}\n{self.options}".encode("utf-8", "backslashreplace"))

    @property
    def settings(self) -> str:
        """The settings that are not the default, as TOML."""
        return tomli_w.dumps(self.cfg.model_dump(mode="json", exclude_defaults=True))

    @property
    def options(self) -> str:
        """The other options, as on the command line."""
        given: dict[str, float | None] = {
            "start": self.time_range.start_s,
            "end": self.time_range.end_s,
            "frames": self.time_range.frames,
            "split": self.split_s,
            "warm-up": self.warm_up_s if self.split_s is not None else None,
        }
        topics = (f"--topic {role}={topic}" for role, topic in sorted(self.topics))
        return " ".join(
            (*topics, *(f"--{name} {_exactly(value)}" for name, value in given.items() if value is not None))
        )


def _exactly(value: float) -> str:
    """A number with all its digits: another one is another configuration."""
    return str(value).removesuffix(".0")


@cache
def code_digest() -> str:
    """Eight hexadecimal digits of the modules that results depend on.

    Who changes the chain has its logs replayed anew, without a new version; compiled loops have a plain form with the
    same results, which is among the modules.
    """
    root = Path(roadperc_stream.__file__).parent
    modules = [path for pattern in _RESULTS_DEPEND_ON for path in root.glob(pattern)]
    texts = {path.relative_to(root).as_posix(): path.read_bytes() for path in modules}
    return _digest(b"".join(name.encode() + b"\0" + texts[name] for name in sorted(texts)))


@cache
def libraries() -> str:
    """The versions of the libraries that compute."""
    return ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:_DIGITS]
