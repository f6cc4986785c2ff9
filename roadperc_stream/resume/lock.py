"""A lock on a folder for one process at a time; the system releases it when the process ends."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path


class FolderLock:
    """A lock on an existing folder. On a file system without locks, every process gets it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._number: int | None = None

    @property
    def is_held(self) -> bool:
        """Whether this object holds the lock."""
        return self._number is not None

    def take(self) -> bool:
        """Take the lock; False if another process holds it. A folder that was removed needs no lock.

        Raises:
            OSError: the folder cannot be opened, or is not a folder.
        """
        if self.is_held:
            return True
        try:
            number = os.open(self._path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:
            return True
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            there = self._path.lstat()
        except BlockingIOError:
            os.close(number)
            return False
        except OSError:
            there = None
        if there is None or os.path.samestat(there, os.fstat(number)):
            self._number = number
        else:  # removed, and created again by another process
            os.close(number)
        return self.is_held

    def release(self) -> None:
        """Release the lock if it is held."""
        if self._number is not None:
            with suppress(OSError):
                os.close(self._number)
            self._number = None
