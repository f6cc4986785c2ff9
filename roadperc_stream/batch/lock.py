"""One batch at a time writes a dataset: a second one ends with an error that names the first."""

import fcntl
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import msgspec
import psutil

from roadperc_stream.batch.location import Location
from roadperc_stream.errors import RoadpercError, StorageError
from roadperc_stream.system.files import target_errors

LOCK: Final = ".lock"
"""The file of a dataset that names the running batch."""
_TOLERANCE_S: Final = 5.0
"""By this much the start of a process may seem later after the clock was set."""


@dataclass(frozen=True)
class LockHolder:
    """A running batch; ``created_s`` is the start of its process, because its number may be used again."""

    host: str
    process: int
    created_s: float

    @classmethod
    def me(cls) -> Self:
        """This process."""
        return cls(socket.gethostname(), os.getpid(), psutil.Process().create_time())

    @property
    def has_ended(self) -> bool:
        """Whether its process has certainly ended; always False for a process of another machine."""
        if self.host != socket.gethostname():
            return False
        try:
            return psutil.Process(self.process).create_time() > self.created_s + _TOLERANCE_S
        except psutil.NoSuchProcess:
            return True


@contextmanager
def dataset_lock(out: Location) -> Iterator[None]:
    """Name this batch in the dataset's lock file within the context.

    The file of a batch that was killed is replaced if it ran on this machine.

    Raises:
        StorageError: another batch is named there, or the dataset cannot be written.
    """
    if out.is_local and Path(out.address).is_file():
        raise StorageError(f"{out.address}: is a file, expected the folder of a dataset")
    file, mine = out.at(LOCK), msgspec.json.encode(LockHolder.me())
    with _excluding_others(out):
        _require_ended(_holder_in(file), file)
        file.write(mine)
    try:
        yield
    finally:
        with suppress(RoadpercError):
            if file.read() == mine:
                file.remove()


@contextmanager
def _excluding_others(out: Location) -> Iterator[None]:
    """Wait until no other batch is in the context. A store and some network file systems exclude no other batch."""
    if not out.is_local:
        yield
        return
    folder = Path(out.address)
    with target_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _require_ended(holder: LockHolder | None, file: Location) -> None:
    if holder is None or holder.has_ended:
        return
    started = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(holder.created_s))
    who = f"host {holder.host}, process {holder.process}, started {started}"
    remedy = "" if holder.host == socket.gethostname() else f"; if it was killed, remove {file.address}"
    dataset = file.address.removesuffix(f"/{LOCK}")
    raise StorageError(f"{dataset}: another batch writes this dataset: {who}; wait until it ends{remedy}")


def _holder_in(file: Location) -> LockHolder | None:
    try:
        return msgspec.json.decode(file.read() or b"", type=LockHolder)
    except msgspec.DecodeError:
        return None
