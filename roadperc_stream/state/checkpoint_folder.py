"""Checkpoints of a replay: what is complete, on disk, so that a replay that was killed goes on from there.

They lie in a hidden folder next to the output, which one replay at a time holds: ``frames`` has what is written of
every frame, one record behind the other, ``state`` what is remembered after the last of them and how long ``frames``
was then. What stands behind that length in ``frames`` was written after the checkpoint, and is computed again.
"""

import os
import shutil
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, Self

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.core.datatypes import ReasonKind
from roadperc_stream.core.files import sync_folder, target_errors
from roadperc_stream.core.reasons import ReasonCount
from roadperc_stream.errors import StateError
from roadperc_stream.output.writing import FrameOutput
from roadperc_stream.state.bounds import StateBounds
from roadperc_stream.state.encoding import decode, encode
from roadperc_stream.state.lock import FolderLock
from roadperc_stream.state.replay_state import ReplayMemory

_LENGTH: Final = struct.Struct("<Q")
_FRAMES, _STATE = "frames", "state"


@dataclass(frozen=True)
class Counted:
    """The reasons of the frames so far, and how many there were whose pictures could not be drawn."""

    reasons: tuple[tuple[ReasonKind, ReasonCount], ...] = ()
    without_image: int = 0
    misfits: int = 0


@dataclass(frozen=True)
class Checkpoint:
    """How far a replay had come.

    ``run`` says by name and value what it was a replay of; two that are equal in it give the same results. ``samples``
    are done, ``length`` is that of the file of their outputs.
    """

    run: Mapping[str, str]
    samples: int
    length: int
    memory: ReplayMemory
    counted: Counted


def checkpoint_folder(target: Path) -> Path:
    """Where the checkpoints of an output lie."""
    return target.with_name(f".{target.name}.checkpoint")


class CheckpointFolder:
    """Reads and writes the checkpoints of one output. Use it as a context manager, or only to read."""

    def __init__(self, target: Path, limits: LimitsConfig = DEFAULT_LIMITS) -> None:
        self.path = checkpoint_folder(target)
        self._bounds = StateBounds.of(limits)
        self._lock = FolderLock(self.path)
        self._frames: IO[bytes] | None = None

    def __enter__(self) -> Self:
        """Hold the folder, where it is there.

        Raises:
            StateError: another replay holds it, or it is no folder.
        """
        if self.path.is_symlink() or (self.path.exists() and not self.path.is_dir()):
            raise self.damaged("is no folder")
        if self.path.exists():
            self._hold()
        return self

    def __exit__(self, *_: object) -> None:
        """Give it free; one without any checkpoint goes."""
        self.close()
        try:
            if self._lock.is_held and not self.holds_one:
                self.remove()
        finally:
            self._lock.release()

    def _hold(self) -> None:
        with target_errors(self.path):
            is_ours = self._lock.take()
        if not is_ours:
            raise StateError(f"{self.path}: another replay of the same output is at work; wait until it has ended")

    def read(self) -> Checkpoint | None:
        """The latest checkpoint; None where there is none.

        Raises:
            StateError: it cannot be read.
        """
        try:
            checkpoint = decode((self.path / _STATE).read_bytes(), Checkpoint, self._bounds)
            is_whole = (self.path / _FRAMES).stat().st_size >= checkpoint.length
        except FileNotFoundError:
            return None
        except (OSError, StateError) as error:
            raise self.damaged(str(error)) from error
        if not is_whole:
            raise self.damaged("its frames are cut short")
        return checkpoint

    def damaged(self, words: str) -> StateError:
        """The error of checkpoints that cannot be used."""
        return StateError(f"{self.path}: {words}; remove it to start over")

    def outputs(self, checkpoint: Checkpoint) -> Iterator[FrameOutput]:
        """What was written of the frames up to a checkpoint, in their order.

        Raises:
            StateError: it cannot be read.
        """
        with target_errors(self.path), (self.path / _FRAMES).open("rb") as frames:
            while frames.tell() < checkpoint.length:
                try:
                    (length,) = _LENGTH.unpack(frames.read(_LENGTH.size))
                    output = decode(frames.read(min(length, checkpoint.length)), FrameOutput, self._bounds)
                except (struct.error, StateError) as error:
                    raise self.damaged(str(error)) from error
                yield output

    def begin(self, checkpoint: Checkpoint | None) -> None:
        """Prepare for more frames, behind a checkpoint; without one anything that is there is removed."""
        with target_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            self._hold()
            if checkpoint is None:
                self._clear()
            self._frames = os.fdopen(_opened_to_append(self.path / _FRAMES), "ab")
            self._frames.truncate(0 if checkpoint is None else checkpoint.length)
            self._frames.seek(0, os.SEEK_END)  # else its length counts from the end it had
            sync_folder(self.path.parent)

    def append(self, output: FrameOutput) -> None:
        """Add a frame: it counts from the next checkpoint on."""
        assert self._frames is not None
        data = encode(output)
        with target_errors(self.path):
            self._frames.write(_LENGTH.pack(len(data)) + data)

    @property
    def length(self) -> int:
        """Length of the file of frames."""
        assert self._frames is not None
        return self._frames.tell()

    def write(self, checkpoint: Checkpoint) -> None:
        """Make a checkpoint durable: first the frames, then what says how many they are, in one step."""
        assert self._frames is not None
        new = self.path / f"{_STATE}.new"
        with target_errors(self.path):
            self._frames.flush()
            os.fsync(self._frames.fileno())
            new.unlink(missing_ok=True)
            with new.open("xb") as state:
                state.write(encode(checkpoint))
                state.flush()
                os.fsync(state.fileno())
            new.replace(self.path / _STATE)
            sync_folder(self.path)

    @property
    def exists(self) -> bool:
        """Whether a replay has begun to keep some, and has not come to its end."""
        return self.path.exists()

    @property
    def holds_one(self) -> bool:
        """Whether there is a checkpoint."""
        return (self.path / _STATE).exists()

    def close(self) -> None:
        """Write nothing any more."""
        if self._frames is not None:
            with suppress(OSError):
                self._frames.close()

    def remove(self) -> None:
        """Remove all checkpoints and the folder; it is held until then."""
        self.close()
        with target_errors(self.path):
            if self.path.exists():
                self._clear()
                shutil.rmtree(self.path)

    def _clear(self) -> None:
        """Remove all checkpoints, what says how many frames there are first."""
        for name in (_STATE, f"{_STATE}.new", _FRAMES):
            (self.path / name).unlink(missing_ok=True)


def _opened_to_append(path: Path) -> int:
    """A file that is no link: what it points to would be written to."""
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0), 0o666)
