"""What goes to a worker, and what comes back: both are sent between processes and machines."""

import hashlib
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Final, Literal

from roadperc_stream.batch.configuration import BatchConfiguration
from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.schemas.columns.runs import RunStatus
from roadperc_stream.storage.folder import Folder
from roadperc_stream.storage.stored import StoredFile

KeepLogs = Literal["no", "whole", "results"]
"""Which result log stays in the dataset: none, one as a replay writes it, or one without the input's messages."""
SCRATCH: Final = ".work"
"""The folder of a local dataset for what is not complete."""
BUSY: Final = "busy"
"""The status of a task whose log another batch is at work on."""
CUT: Final = "cut"
"""The status of a task whose log is to be replayed in parts."""
_KEY_DIGITS: Final = 16
_MB: Final = 1e6


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
class TaskLimits:
    """What an attempt at a log may take: seconds, and bytes of memory; no end of time unless said."""

    timeout_s: float | None = None
    memory_bytes: int = 2_000_000_000


NO_TIMEOUT: Final = TaskLimits()


@dataclass(frozen=True)
class Task:
    """A log to replay under a configuration into a dataset.

    Args:
        drive: the log.
        how: the configuration.
        out: the dataset.
        keep_logs: the result log to keep.
        recover: replay what can be read of a damaged log.
        was_recovered: whether what the dataset has of it is so; it is looked at in the same way, to see whether it is
            the same still.
        limits: of each attempt.
        same_ids: logs that are in the dataset already and that this one may be, under another name or another time of
            change: then nothing is left to do.
        code: digest of the code that the batch was started with, which is to be the worker's.
        scratch: a folder for temporary files on the worker's machine; None: within the dataset, or the system's.
        piece: the part of the log that is to be replayed, or the replayed parts that are to be joined; None: replay it
            whole, or find out in what parts.
        is_audited: as ``CutLog``.
    """

    drive: DriveFiles
    how: BatchConfiguration
    out: Folder
    keep_logs: KeepLogs = "no"
    recover: bool = False
    limits: TaskLimits = NO_TIMEOUT
    same_ids: tuple[str, ...] = ()
    code: str = ""
    scratch: Path | None = None
    piece: "SplitPart | EndedParts | None" = None
    is_audited: bool = False
    was_recovered: bool = False

    @cached_property
    def content_key(self) -> str:
        """Differs where the log, or what replays it, has changed: nothing that is not complete then is of use."""
        return hashlib.sha256(f"{self.drive.fingerprint}\n{self.code}".encode()).hexdigest()[:_KEY_DIGITS]

    @cached_property
    def log_key(self) -> str:
        """Names the log and the configuration where the log's digest is not known yet."""
        return hashlib.sha256(f"{self.drive.name}\n{self.how.name}".encode()).hexdigest()[:_KEY_DIGITS]

    @property
    def key(self) -> str:
        """Names the task among all that are at work."""
        return f"{self.log_key}-{self.piece.index}" if isinstance(self.piece, SplitPart) else self.log_key


@dataclass(frozen=True)
class CutLog:
    """A log that is to be replayed in parts; ``first_ns`` is the log time of its first message."""

    log_id: str
    first_ns: int
    parts: tuple[SplitPart, ...]
    is_audited: bool = False
    """Whether it has been checked so that its parts need not be, nor fetched whole (``input.ReplaySource``)."""


@dataclass(frozen=True)
class Outcome:
    """How an attempt ended; what is not known is None or 0.

    ``is_new`` is False where the log was in the dataset already, ``stages_s`` are the seconds of each stage by column,
    ``frames_before`` those that an interrupted attempt had computed, ``cut`` is how a log was cut.
    """

    status: RunStatus | Literal["busy", "cut"]
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
    cut: CutLog | None = None


@dataclass(frozen=True)
class EndedPart:
    """A part of a log that has been replayed, and how that ended."""

    part: SplitPart
    outcome: Outcome


@dataclass(frozen=True)
class EndedParts:
    """All parts of a log."""

    cut: CutLog
    parts: tuple[EndedPart, ...]


def this_worker() -> str:
    """Host and process, as rows name them."""
    return f"{socket.gethostname()}:{os.getpid()}"


def as_text(words: str) -> str:
    """Words in which the bytes of a file's name that are no text are escaped: no table takes them."""
    return words.encode("utf-8", "backslashreplace").decode()


def megabytes(size: float) -> str:
    """A size in memory, in words."""
    return f"{size / _MB:.0f} MB"
