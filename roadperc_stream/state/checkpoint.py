"""Checkpoints of a replay: what is complete, on disk, so that a replay that was killed goes on from there.

They lie in a hidden folder next to the output: ``frames`` holds what is written of every frame, one record behind the
other, ``state`` what is remembered after the last of them and how long ``frames`` was then. What stands behind that
length in ``frames`` was written after the checkpoint, and is computed again.
"""

import os
import shutil
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, Self

from roadperc_stream.core.datatypes import ReasonKind
from roadperc_stream.core.files import target_errors
from roadperc_stream.core.reasons import ReasonCount
from roadperc_stream.core.time import seconds_to_ns
from roadperc_stream.errors import StateError
from roadperc_stream.output.writing import FrameOutput
from roadperc_stream.state.encoding import decode, encode
from roadperc_stream.state.identity import differences
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


@dataclass(frozen=True)
class CheckpointOptions:
    """Whether a replay keeps checkpoints, and goes on from one; neither unless said.

    Args:
        every_s: seconds of log after which what is complete is made durable; None: never.
        resume: go on from the latest one, where there is one.
    """

    every_s: float | None = None
    resume: bool = False


NO_CHECKPOINTS: Final = CheckpointOptions()


def checkpoint_folder(target: Path) -> Path:
    """Where the checkpoints of an output lie."""
    return target.with_name(f".{target.name}.checkpoint")


class CheckpointFolder:
    """Reads and writes the checkpoints of one output. Use it as a context manager, or only to read."""

    def __init__(self, target: Path) -> None:
        self.path = checkpoint_folder(target)
        self._frames: IO[bytes] | None = None

    def read(self) -> Checkpoint | None:
        """The latest checkpoint; None where there is none.

        Raises:
            StateError: it cannot be read.
        """
        try:
            checkpoint = decode((self.path / _STATE).read_bytes(), Checkpoint)
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
                    output = decode(frames.read(min(length, checkpoint.length)), FrameOutput)
                except (struct.error, StateError) as error:
                    raise self.damaged(str(error)) from error
                yield output

    def begin(self, checkpoint: Checkpoint | None) -> None:
        """Prepare for more frames, behind a checkpoint; without one anything that is there is removed."""
        with target_errors(self.path):
            if checkpoint is None:
                self.remove()
            self.path.mkdir(parents=True, exist_ok=True)
            self._frames = (self.path / _FRAMES).open("ab")
            self._frames.truncate(0 if checkpoint is None else checkpoint.length)
            self._frames.seek(0, os.SEEK_END)  # else its length counts from the end it had
            _sync_folder(self.path.parent)

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
            with new.open("wb") as state:
                state.write(encode(checkpoint))
                state.flush()
                os.fsync(state.fileno())
            new.replace(self.path / _STATE)
            _sync_folder(self.path)

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
        """Remove all checkpoints, the one that says how many frames there are first."""
        self.close()
        with target_errors(self.path):
            (self.path / _STATE).unlink(missing_ok=True)
            if self.path.exists():
                shutil.rmtree(self.path)


class Checkpoints:
    """Those of one replay while it runs, and the one it goes on from. Use it as a context manager.

    What has been written stays where the replay does not come to its end, but for a folder without any checkpoint.
    """

    def __init__(
        self,
        folder: CheckpointFolder,
        every_s: float | None,
        run: Mapping[str, str],
        found: Checkpoint | None,
        *,
        force: bool,
    ) -> None:
        """Check that the one found is of this replay.

        Args:
            folder: reads and writes them.
            every_s: seconds of log between two; None: none is written.
            run: what is replayed.
            found: to go on from; None to begin.
            force: start over where it is of another replay, or where there are some that nobody asked to go on from.

        Raises:
            StateError: it is of another one.
        """
        self._folder, self._run = folder, run
        self._every_ns = None if every_s is None else seconds_to_ns(every_s)
        self._found = _of_this_run(folder, run, found, force=force)
        self._last_ns: int | None = None
        if found is None and every_s is not None and not force and folder.holds_one:
            raise StateError(
                f"{folder.path}: a replay was interrupted; --resume goes on from there, --force starts over"
            )

    @property
    def samples(self) -> int:
        """How many are done already."""
        return 0 if self._found is None else self._found.samples

    @property
    def memory(self) -> ReplayMemory:
        """What is remembered after those."""
        assert self._found is not None
        return self._found.memory

    @property
    def counted(self) -> Counted:
        """What was counted in those."""
        return Counted() if self._found is None else self._found.counted

    def next_output(self, index: int) -> FrameOutput:
        """What was written of the next of those that are written at all.

        Args:
            index: number of the frame.

        Raises:
            StateError: it cannot be read, or is of another frame.
        """
        output = next(self._outputs, None)
        if output is None or output.row.frame != index:
            raise self._folder.damaged(f"does not hold frame {index}")
        return output

    def __enter__(self) -> Self:
        if self._found is not None:
            self._outputs = self._folder.outputs(self._found)
        if self._every_ns is not None:
            self._folder.begin(self._found)
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.close()
        if self._every_ns is not None and not self._folder.holds_one:
            self._folder.remove()

    def keep(self, output: FrameOutput | None) -> None:
        """Keep what is written of one more frame."""
        if self._every_ns is not None and output is not None:
            self._folder.append(output)

    def reached(self, log_time_ns: int, samples: int, memory: ReplayMemory, counted: Callable[[], Counted]) -> None:
        """Write a checkpoint, where it is time for one and the frame is not one of those that were done already.

        Args:
            log_time_ns: of the last frame.
            samples: done so far.
            memory: after them.
            counted: gives what was counted in them.
        """
        if self._every_ns is None:
            return
        if self._last_ns is None or samples <= self.samples:
            self._last_ns = log_time_ns
        elif log_time_ns - self._last_ns >= self._every_ns:
            self._folder.write(Checkpoint(self._run, samples, self._folder.length, memory, counted()))
            self._last_ns = log_time_ns

    def remove(self) -> None:
        """Remove them: the replay is complete."""
        if self._every_ns is not None or self._found is not None:
            self._folder.remove()


def _of_this_run(
    folder: CheckpointFolder, run: Mapping[str, str], found: Checkpoint | None, *, force: bool
) -> Checkpoint | None:
    if found is None or not (names := differences(found.run, run)):
        return found
    if force:
        return None
    raise StateError(f"{folder.path}: of another replay ({', '.join(names)} differ); --force (force=True) starts over")


def _sync_folder(folder: Path) -> None:
    """Make the names in a folder durable, where the system can."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
