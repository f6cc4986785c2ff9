"""Checkpoints: the complete frames of a replay on disk, so that an interrupted replay can continue.

They are in a hidden folder next to the output. One replay at a time holds a lock on it. ``frames`` has one record for
the output of each frame. ``state`` has the replay's state after the last record, and the length of ``frames`` then.
Later records were written after the checkpoint; a resumed replay computes them again.
"""

import os
import shutil
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Final, Self

from roadperc_stream.chain.encoding import decode, encode
from roadperc_stream.errors import StateError
from roadperc_stream.output.writing import FrameOutput
from roadperc_stream.resume.lock import FolderLock
from roadperc_stream.resume.state import ReplayState
from roadperc_stream.system.files import target_errors
from roadperc_stream.system.time import seconds_to_ns

_LENGTH: Final = struct.Struct("<Q")
_FRAMES, _STATE = "frames", "state"


@dataclass(frozen=True)
class Checkpoint:
    """The progress of a replay.

    ``run`` has all inputs and options that the results depend on, by name and value. ``samples`` is the number of
    samples done, including those of a warm-up, ``length`` the length of the file with their outputs.
    """

    run: Mapping[str, str]
    state: ReplayState
    samples: int = 0
    length: int = 0


def checkpoint_folder(target: Path) -> Path:
    """The folder for the checkpoints of an output."""
    return target.parent / f".{target.name}.checkpoint"  # a folder such as `..` has no name


class CheckpointFolder:
    """Reads and writes the checkpoints of one output. Use it as a context manager, or only to read."""

    def __init__(self, target: Path) -> None:
        self.path = checkpoint_folder(target)
        self._lock = FolderLock(self.path)
        self._frames: IO[bytes] | None = None

    def __enter__(self) -> Self:
        """Hold the folder, if it exists.

        Raises:
            StateError: another replay holds it, or it is not a folder.
        """
        if self.path.is_symlink() or (self.path.exists() and not self.path.is_dir()):
            raise self.damaged("not a folder")
        if self.path.exists():
            self._hold()
        return self

    def __exit__(self, *_: object) -> None:
        """Release the folder; remove it if it has no checkpoint."""
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
            raise StateError(f"{self.path}: another replay writes the same output; wait until it ends")

    def read(self) -> Checkpoint | None:
        """The latest checkpoint; None without one.

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
        """The error for checkpoints that cannot be used."""
        return StateError(f"{self.path}: {words}; remove it to start over")

    def outputs(self, checkpoint: Checkpoint) -> Iterator[FrameOutput]:
        """The outputs of the frames up to a checkpoint, in order.

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
        """Prepare for more frames after a checkpoint; without one remove what is in the folder."""
        with target_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            self._hold()
            if checkpoint is None:
                self._clear()
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW
            self._frames = os.fdopen(os.open(self.path / _FRAMES, flags, 0o666), "ab")
            self._frames.truncate(0 if checkpoint is None else checkpoint.length)
            self._frames.seek(0, os.SEEK_END)  # tell() would return the length before truncation

    def append(self, output: FrameOutput) -> None:
        """Add a frame; the next checkpoint includes it."""
        assert self._frames is not None
        data = encode(output)
        with target_errors(self.path):
            self._frames.write(_LENGTH.pack(len(data)) + data)

    def write(self, checkpoint: Checkpoint) -> None:
        """Write a checkpoint of all frames: first the frames, then the state with their number."""
        assert self._frames is not None
        checkpoint = replace(checkpoint, length=self._frames.tell())
        new = self.path / f"{_STATE}.new"
        with target_errors(self.path):
            self._frames.flush()
            new.unlink(missing_ok=True)
            with new.open("xb") as state:
                state.write(encode(checkpoint))
            new.replace(self.path / _STATE)

    def proves_ours(self, *, is_complete: bool) -> bool:
        """Whether an interrupted replay wrote the files of the output; without a checkpoint they are not complete."""
        return self.path.exists() and (self.holds_one or not is_complete)

    @property
    def holds_one(self) -> bool:
        """Whether there is a checkpoint."""
        return (self.path / _STATE).exists()

    def close(self) -> None:
        """Close the file of frames."""
        if self._frames is not None:
            with suppress(OSError):
                self._frames.close()

    def remove(self) -> None:
        """Remove all checkpoints and the folder."""
        self.close()
        with target_errors(self.path):
            if self.path.exists():
                self._clear()
                shutil.rmtree(self.path)

    def _clear(self) -> None:
        """Remove all checkpoints, the state with the number of frames first."""
        for name in (_STATE, f"{_STATE}.new", _FRAMES):
            (self.path / name).unlink(missing_ok=True)


class Checkpoints:
    """The checkpoints that a replay writes, and the one that it resumes.

    If the replay is interrupted, its checkpoints stay; a folder without a checkpoint is removed.
    """

    def __init__(
        self,
        folder: CheckpointFolder,
        every_s: float | None,
        start: Checkpoint,
        found: Checkpoint | None,
        *,
        force: bool,
    ) -> None:
        """Check that the found checkpoint is of this replay.

        Args:
            folder: reads and writes the checkpoints.
            every_s: seconds of log between two checkpoints; None for no checkpoints.
            start: the replay before its first sample.
            found: the checkpoint to resume; None to begin.
            force: start over if the checkpoint belongs to another replay, or if there is one but ``found`` is None.

        Raises:
            StateError: the checkpoint belongs to another replay.
        """
        self._folder = folder
        self._every_ns = None if every_s is None else seconds_to_ns(every_s)
        run, known = start.run, start.run if found is None else found.run
        differing = ", ".join(name for name in {**run, **known} if run.get(name) != known.get(name))
        if differing and not force:
            raise StateError(f"{folder.path}: of another replay ({differing} differ)", "--force", "to start over")
        self.is_resumed = found is not None and not differing
        self.progress = found if found is not None and self.is_resumed else start
        """The replay after the samples that an interrupted replay computed."""
        self._last_ns: int | None = None
        left_over = folder.holds_one and not self.is_resumed and every_s is None
        self.notes = (f"{folder.path}: left by an interrupted replay; removed",) if left_over else ()
        if found is None and every_s is not None and not force and folder.holds_one:
            raise StateError(f"{folder.path}: left by an interrupted replay", "--resume or --force", "(start over)")

    def begin(self) -> None:
        """Prepare to read the complete frames, and to write checkpoints if enabled."""
        if self.is_resumed:
            self._outputs = self._folder.outputs(self.progress)
        if self._every_ns is not None:
            self._folder.begin(self.progress if self.is_resumed else None)

    def next_output(self, index: int) -> FrameOutput:
        """The output of the next complete frame.

        ``index`` is the number of the frame.

        Raises:
            StateError: it cannot be read, or belongs to another frame.
        """
        output = next(self._outputs, None)
        if output is None or output.row.frame != index:
            raise self._folder.damaged(f"does not hold frame {index}")
        return output

    def keep(self, output: FrameOutput | None) -> None:
        """Keep the output of one more frame."""
        if self._every_ns is not None and output is not None:
            self._folder.append(output)

    def reached(self, log_time_ns: int, samples: int, state: ReplayState) -> None:
        """Write a checkpoint if it is due and the sample is new.

        ``log_time_ns`` is that of the last frame, ``state`` that after all complete ``samples``.
        """
        if self._every_ns is None:
            return
        if self._last_ns is None or samples <= self.progress.samples:
            self._last_ns = log_time_ns
        elif log_time_ns - self._last_ns >= self._every_ns:
            self._folder.write(Checkpoint(self.progress.run, state, samples))
            self._last_ns = log_time_ns
