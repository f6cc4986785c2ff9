"""Tasks for workers, and their outcomes; both are sent between processes and machines."""

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

from roadperc_stream.batch.location import Location, StoredFile
from roadperc_stream.config import ReplayConfig
from roadperc_stream.info.contract import Contract
from roadperc_stream.schemas.columns.runs import RunStatus
from roadperc_stream.system.files import TABLE_SUFFIX
from roadperc_stream.system.time import WHOLE, TimeRange

_DIGITS: Final = 8
RESULTS_VERSION: Final = "12"
"""Raised by hand when the results of the chain change: a batch then replays all logs again."""
_LIBRARIES: Final = ("numpy", "opencv-python-headless", "scipy")


@dataclass(frozen=True)
class BatchConfiguration:
    """Everything that results depend on, except the log.

    Args:
        cfg: the chain's configuration.
        topics: (role, topic) for topics with other names.
        time_range: the part of every log to replay.
    """

    cfg: ReplayConfig
    topics: tuple[tuple[str, str], ...] = ()
    time_range: TimeRange = WHOLE

    @cached_property
    def name(self) -> str:
        """Eight hexadecimal digits of the values that are not the default, so that a new setting changes no name."""
        return _digest(f"{self.settings}\n{self.options}".encode("utf-8", "backslashreplace"))

    @property
    def settings(self) -> str:
        """The settings that are not the default, as TOML."""
        return tomli_w.dumps(self.cfg.model_dump(mode="json", exclude_defaults=True))

    @property
    def options(self) -> str:
        """The other options, as on the command line."""
        part = self.time_range
        limits = {"start": part.start_s, "end": part.end_s, "frames": part.frames}
        topics = (f"--topic {role}={topic}" for role, topic in sorted(self.topics))
        # All digits: another number is another configuration.
        numbers = {name: str(value).removesuffix(".0") for name, value in limits.items() if value is not None}
        return " ".join((*topics, *(f"--{name} {value}" for name, value in numbers.items())))


@cache
def libraries() -> str:
    """The versions of the numeric libraries."""
    return ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:_DIGITS]


KeepLogs = Literal["no", "whole", "results"]
"""The result log in the dataset: none, a whole one, or one without the input's messages."""
METRICS, OBJECTS, LOGS, SCRATCH = "metrics", "objects", "logs", ".work"
"""The folders of a dataset; only a local dataset has the last one, for partial files."""
_KEY_DIGITS: Final = 16


def name_in(folder: str, date: str, log_id: str, config: str) -> str:
    """The name of a file in the dataset, of a log under a configuration."""
    return f"{folder}/date={date}/{log_id}-{config}{'.mcap' if folder == LOGS else TABLE_SUFFIX}"


@dataclass(frozen=True)
class LogFiles:
    """The files of one log, in the order of their names."""

    files: tuple[StoredFile, ...]

    @property
    def name(self) -> str:
        """The path or address of its first file; bytes that are not UTF-8 are escaped."""
        return as_text(self.files[0].address)

    @property
    def stem(self) -> str:
        """The name of its first file without folder and suffix."""
        return PurePosixPath(self.name).stem

    @property
    def size_bytes(self) -> int:
        """The size of all files."""
        return sum(file.size_bytes for file in self.files)

    @cached_property
    def fingerprint(self) -> str:
        """A text that changes when the content of a file may have changed."""
        if len(self.files) == 1:
            return self.files[0].fingerprint
        text = "\n".join(f"{file.address} {file.fingerprint}" for file in self.files)
        return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


@dataclass(frozen=True)
class BatchJob:
    """The options of a batch.

    Args:
        configuration: of all replays.
        out: the dataset.
        keep_logs: the result log to keep.
        recover: replay the readable part of damaged logs.
        timeout_s: limit of an attempt in seconds; None for no limit.
        memory_bytes: limit of an attempt.
        retries: retries of a log whose worker died.
        fail_fast: stop at the first log that fails.
        verify: read every log instead of trusting its size and modification time.
        retry_failed: replay damaged and empty logs again, although they have not changed.
        scratch: folder for temporary files on the workers' machines; None for the dataset, or the system's folder.
        contract: limits of every log; None without.
    """

    configuration: BatchConfiguration
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
    contract: Contract | None = None


@dataclass(frozen=True)
class Task:
    """A log to replay into a dataset.

    Args:
        log: the log.
        job: the options of the batch.
        known_ids: ids of logs in the dataset whose content this log may have; a log with one of them is not replayed.
        was_recovered: the dataset's log was recovered, so this log is read with ``--recover`` for the comparison.
        results_version: of the batch; the workers must have it too.
    """

    log: LogFiles
    job: BatchJob
    known_ids: tuple[str, ...] = ()
    was_recovered: bool = False
    results_version: str = RESULTS_VERSION

    @cached_property
    def content_key(self) -> str:
        """A text that changes with the log and the code; partial results of another key are useless."""
        return hashlib.sha256(f"{self.log.fingerprint}\n{self.results_version}".encode()).hexdigest()[:_KEY_DIGITS]

    @cached_property
    def key(self) -> str:
        """The name of log and configuration before the log's digest is known."""
        return hashlib.sha256(f"{self.log.name}\n{self.job.configuration.name}".encode()).hexdigest()[:_KEY_DIGITS]


@dataclass(frozen=True)
class Outcome:
    """The outcome of an attempt; unknown values are None or 0.

    ``is_new`` is False if the dataset already has the log. ``stages_s`` has the seconds of each stage by column.
    ``frames_before`` counts the frames of an interrupted attempt.
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
    findings: tuple[str, ...] = ()
    contract: str | None = None
    broken: tuple[str, ...] = ()
    is_new: bool = True
    stages_s: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    peak_memory_mb: float | None = None
    worker: str = ""


def this_worker() -> str:
    """Host and process, as rows name them."""
    return f"{socket.gethostname()}:{os.getpid()}"


def as_text(text: str) -> str:
    """A text for a table: the bytes of a file's name that are not UTF-8 are escaped."""
    return text.encode("utf-8", "backslashreplace").decode()
