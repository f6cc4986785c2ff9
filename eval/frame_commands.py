"""The commands that show a frame of a run; the user can paste them into a shell."""

import shlex
from pathlib import Path

from .runs import Run


def view_command(run: Run, frame: int) -> str:
    """``roadperc-view OUT.mcap --frame N`` for a run; without the log its table, for a batch its dataset."""
    return _command([_argument(run, frame)], frame, run)


def view_pair_command(base: Run, new: Run, frame: int) -> str:
    """The command that shows one frame of two runs side by side."""
    if base.dataset and new.dataset and base.dataset[0] == new.dataset[0]:
        return _command([base.dataset[0]], frame, base, new)
    return _command([_argument(base, frame), _argument(new, frame)], frame, base if base.dataset else new)


def view_dataset_command(address: str, log: str, frame: int, config: str = "") -> str:
    """The command that shows one frame of a log in a dataset; ``log`` is its name in the report or its ``log_id``."""
    configs = ("--config", config) if config else ()
    return shlex.join(["roadperc-view", address, "--log", log, *configs, "--frame", str(frame)])


def _command(arguments: list[str], frame: int, *runs: Run) -> str:
    options = [word for run in runs if run.dataset for word in ("--config", run.dataset[1])]
    log = ["--log", runs[0].name] if options else []
    return shlex.join(["roadperc-view", *arguments, *log, *options, "--frame", str(frame)])


def _argument(run: Run, frame: int) -> str:
    """The dataset, the log if it exists, or the table of a run."""
    if run.dataset:
        return run.dataset[0]
    begun = [table for table in run.tables if table.first_frame <= frame] or [run]
    table = begun[-1]
    log = table.beside(".mcap")
    return _path(log if log.exists() else table.path)


def _path(path: Path) -> str:
    return f"./{path}" if str(path).startswith("-") else str(path)
