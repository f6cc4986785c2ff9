"""What goes to a worker, and what comes back: both are sent between processes and machines."""

import hashlib
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Final, Literal

import tomli_w

import roadperc_stream
from roadperc_stream.batch.storage.location import Location, StoredFile
from roadperc_stream.config import ReplayConfig
from roadperc_stream.schemas.columns.runs import RunStatus
from roadperc_stream.system.files import TABLE_SUFFIX
from roadperc_stream.system.time import WHOLE, TimeRange

_DIGITS: Final = 8
_FOLDERS: Final = (
    *("chain", "config", "formats", "geometry", "input", "log"),
    *("metrics", "model", "output", "resume", "schemas", "system"),
)
_RESULTS_DEPEND_ON: Final = ("*.py", *(f"{name}/**/*.py" for name in _FOLDERS))
_LIBRARIES: Final = ("numpy", "opencv-python-headless", "scipy")


@dataclass(frozen=True)
class BatchConfiguration:
    """Everything but the log that results depend on.

    Args:
        cfg: the chain's configuration.
        topics: role and topic, where logs have topics of their own.
        time_range: the part of every log to replay.
    """

    cfg: ReplayConfig
    topics: tuple[tuple[str, str], ...] = ()
    time_range: TimeRange = WHOLE

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

    A change of the chain replays all logs again, without a new version. A compiled kernel does not count: its plain
    form has the same results and is among the modules.
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


KeepLogs = Literal["no", "whole", "results"]
"""Which result log stays in the dataset: none, one as a replay writes it, or one without the input's messages."""
METRICS, OBJECTS, LOGS, SCRATCH = "metrics", "objects", "logs", ".work"
"""The folders of a dataset; the last one is for partial files, in a local dataset only."""
_KEY_DIGITS: Final = 16


def name_in(folder: str, date: str, log_id: str, config: str) -> str:
    """The name in the dataset of a log's file under a configuration."""
    return f"{folder}/date={date}/{log_id}-{config}{'.mcap' if folder == LOGS else TABLE_SUFFIX}"


@dataclass(frozen=True)
class DriveFiles:
    """A log, or the files of one in parts, in the order of their names."""

    files: tuple[StoredFile, ...]

    @property
    def name(self) -> str:
        """The path or address of its first file; bytes of a file's name that are no text are escaped."""
        return as_text(self.files[0].address)

    @property
    def stem(self) -> str:
        """The name of its first file alone."""
        return PurePosixPath(self.name).stem

    @property
    def size_bytes(self) -> int:
        """Of all its files."""
        return sum(file.size_bytes for file in self.files)

    @cached_property
    def fingerprint(self) -> str:
        """Differs whenever what is in the files may."""
        if len(self.files) == 1:
            return self.files[0].fingerprint
        text = "\n".join(f"{file.address} {file.fingerprint}" for file in self.files)
        return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


@dataclass(frozen=True)
class BatchJob:
    """What a batch does with each of its logs.

    Args:
        how: the configuration.
        out: the dataset.
        keep_logs: the result log to keep.
        recover: replay what can be read of damaged logs.
        timeout_s: seconds that an attempt may take; None: as long as it needs.
        memory_bytes: memory that an attempt may take.
        retries: how often a log is tried again whose worker died.
        fail_fast: stop at the first log that fails.
        verify: read every log instead of trusting its size and modification time.
        retry_failed: replay damaged and empty logs again, although they have not changed.
        scratch: folder for temporary files on the workers' machines; None: within the dataset, or the system's.
        code: digest of the code that the batch was started with, which is to be the workers'; empty: not checked.
    """

    how: BatchConfiguration
    out: Location
    keep_logs: KeepLogs = "no"
    recover: bool = False
    timeout_s: float | None = None
    memory_bytes: int = 2_000_000_000
    retries: int = 2
    fail_fast: bool = False
    verify: bool = False
    retry_failed: bool = False
    scratch: Path | None = None
    code: str = ""


@dataclass(frozen=True)
class Task:
    """A log to replay into a dataset.

    Args:
        drive: the log.
        job: what the batch does with it.
        same_ids: logs that are in the dataset already and that this one may be, under another name or another time of
            change: then nothing is left to do.
        was_recovered: whether the dataset's log was recovered; this one is then read in the same way, to see whether it
            is the same still.
    """

    drive: DriveFiles
    job: BatchJob
    same_ids: tuple[str, ...] = ()
    was_recovered: bool = False

    @cached_property
    def content_key(self) -> str:
        """Differs where the log, or what replays it, has changed: nothing that is not complete then is of use."""
        return hashlib.sha256(f"{self.drive.fingerprint}\n{self.job.code}".encode()).hexdigest()[:_KEY_DIGITS]

    @cached_property
    def key(self) -> str:
        """Names the log and the configuration where the log's digest is not known yet."""
        return hashlib.sha256(f"{self.drive.name}\n{self.job.how.name}".encode()).hexdigest()[:_KEY_DIGITS]


@dataclass(frozen=True)
class Outcome:
    """How an attempt ended; what is not known is None or 0.

    ``is_new`` is False where the log was in the dataset already, ``stages_s`` are the seconds of each stage by column,
    ``frames_before`` those that an interrupted attempt had computed.
    """

    status: RunStatus
    error: str | None = None
    log_id: str | None = None
    date: str | None = None
    duration_s: float | None = None
    frames: int = 0
    frames_before: int = 0
    dropped: int = 0
    unreadable: int = 0
    warnings: tuple[str, ...] = ()
    is_new: bool = True
    stages_s: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    peak_memory_mb: float | None = None
    worker: str = ""


def this_worker() -> str:
    """Host and process, as rows name them."""
    return f"{socket.gethostname()}:{os.getpid()}"


def as_text(words: str) -> str:
    """Words in which the bytes of a file's name that are no text are escaped: no table takes them."""
    return words.encode("utf-8", "backslashreplace").decode()
