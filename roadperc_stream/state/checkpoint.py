"""The checkpoints of one replay while it runs: those it goes on from, and those it writes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Self

from roadperc_stream.core.time import seconds_to_ns
from roadperc_stream.errors import StateError
from roadperc_stream.output.writing import FrameOutput
from roadperc_stream.state.checkpoint_folder import Checkpoint, CheckpointFolder, Counted
from roadperc_stream.state.identity import differences
from roadperc_stream.state.replay_state import ReplayMemory


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
        self.left_over = folder.holds_one and self._found is None and every_s is None
        """Whether some are there that this replay has no use for."""
        if found is None and every_s is not None and not force and folder.holds_one:
            raise StateError(
                f"{folder.path}: a replay was interrupted; --resume goes on from there, --force starts over"
            )

    @property
    def are_durable(self) -> bool:
        """Whether what is complete outlives a loss of power."""
        return self._every_ns is not None

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
        self._folder.remove()


def _of_this_run(
    folder: CheckpointFolder, run: Mapping[str, str], found: Checkpoint | None, *, force: bool
) -> Checkpoint | None:
    if found is None or not (names := differences(found.run, run)):
        return found
    if force:
        return None
    raise StateError(f"{folder.path}: of another replay ({', '.join(names)} differ); --force (force=True) starts over")
