"""One batch at a time writes a dataset: a second one ends with an error that names the first."""

import os
import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self
from uuid import uuid4

import msgspec

from roadperc_stream.batch.storage.location import Location
from roadperc_stream.errors import RoadpercError, StorageError
from roadperc_stream.resume.lock import FolderLock
from roadperc_stream.system.files import target_errors

LOCK: Final = ".lock"
"""The file of a dataset that names the running batch."""
RENEW_EVERY_S: Final = 30.0
DEAD_AFTER_S: Final = 120.0
"""A lock in a store without a renewal for this long belongs to a killed batch."""
_SETTLES_S: Final = 1.0
"""Wait after writing a lock; if two batches write at once, both then see the last one."""


@dataclass(frozen=True)
class LockHolder:
    """A running batch: ``token`` is unique, ``renewed_s`` is the time of its last renewal since 1970."""

    host: str
    process: int
    started: str
    token: str
    renewed_s: float

    @property
    def is_alive(self) -> bool:
        """Whether it was renewed recently; a time far in the future comes from a wrong clock and does not count."""
        return abs(time.time() - self.renewed_s) < DEAD_AFTER_S


class DatasetLock:
    """A lock on a dataset: the batch in its context is the only one that writes.

    On a disk the system holds the lock and releases it when the process ends; a file only names the holder. A store has
    no locks: there the file itself is the lock, and a thread renews it.
    """

    def __init__(self, out: Location) -> None:
        started = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime())
        self._out = out
        self._me = LockHolder(socket.gethostname(), os.getpid(), started, uuid4().hex, 0.0)
        self._ended, self._renewing = threading.Event(), threading.Thread(target=self._keep_renewing, daemon=True)
        self._taken_by: LockHolder | None = None

    def __enter__(self) -> Self:
        """Take the lock.

        Raises:
            StorageError: another batch holds it, or the store cannot be reached.
            TargetError: the folder cannot be made.
        """
        if self._out.is_local:
            folder = Path(self._out.address)
            self._on_disk = FolderLock(folder)
            with target_errors(folder):
                folder.mkdir(parents=True, exist_ok=True)
                is_taken = self._on_disk.take()
            if not is_taken:
                raise self._refusal(self._holder())
            with suppress(RoadpercError):  # the lock works without the file
                self._write()
        else:
            self._require_free()
            self._write()
            time.sleep(_SETTLES_S)
            self._require_free()
            self._renewing.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Release the lock."""
        self._ended.set()
        if not self._out.is_local:
            self._renewing.join()
        if self._taken_by is None:
            with suppress(RoadpercError):  # otherwise it expires
                self._out.at(LOCK).remove()
        if self._out.is_local:
            self._on_disk.release()

    @property
    def is_held(self) -> bool:
        """Whether this batch still has the lock; another batch may take a lock that is not renewed."""
        return self._taken_by is None

    def require_held(self) -> None:
        """Check that this batch still has the lock.

        Raises:
            StorageError: another batch has taken it.
        """
        if self._taken_by is not None:
            raise self._refusal(self._taken_by)

    def _require_free(self) -> None:
        if (other := self._other()) is not None:
            raise self._refusal(other)

    def _other(self) -> LockHolder | None:
        holder = self._holder()
        return holder if holder is not None and holder.token != self._me.token and holder.is_alive else None

    def _holder(self) -> LockHolder | None:
        try:
            return msgspec.json.decode(self._out.at(LOCK).read() or b"", type=LockHolder)
        except msgspec.DecodeError:
            return None

    def _write(self) -> None:
        # Whole seconds: clients fail at an object whose length changes while they read it.
        self._out.at(LOCK).write(msgspec.json.encode(replace(self._me, renewed_s=float(int(time.time())))))

    def _keep_renewing(self) -> None:
        while self._taken_by is None and not self._ended.wait(RENEW_EVERY_S):
            try:
                self._taken_by = self._other()
                if self._taken_by is None:
                    self._write()
            except RoadpercError:
                continue  # the next renewal may succeed

    def _refusal(self, holder: LockHolder | None) -> StorageError:
        who = f": host {holder.host}, process {holder.process}, started {holder.started}" if holder else ""
        until = "" if self._out.is_local else f", or {DEAD_AFTER_S:g} s after it was killed"
        return StorageError(f"{self._out.address}: another batch writes this dataset{who}; wait until it ends{until}")
