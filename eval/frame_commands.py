"""The commands that show a frame of a run; the user can paste them into a shell."""

import shlex

from .runs import Run


def view_command(run: Run, frame: int) -> str:
    """``roadperc-view OUT.mcap --frame N`` for a run; without the log its table, for a batch its dataset."""
    return _command(frame, run)


def view_pair_command(base: Run, new: Run, frame: int) -> str:
    """The command that shows one frame of two runs side by side."""
    return _command(frame, base, new)


def view_dataset_command(address: str, log: str, frame: int, config: str = "") -> str:
    """The command that shows one frame of a log in a dataset; ``log`` is its name in the report or its ``log_id``."""
    configs = ("--config", config) if config else ()
    return shlex.join(["roadperc-view", address, "--log", log, *configs, "--frame", str(frame)])


def _command(frame: int, *runs: Run) -> str:
    arguments = dict.fromkeys(_argument(run, frame) for run in runs)
    configs = dict.fromkeys(run.dataset[1] for run in runs if run.dataset)
    options = [word for config in configs for word in ("--config", config)]
    log = ["--log", runs[0].name] if configs else []
    return shlex.join(["roadperc-view", *arguments, *log, *options, "--frame", str(frame)])


def _argument(run: Run, frame: int) -> str:
    """The dataset, the log if it exists, or the table of a run."""
    if run.dataset:
        return run.dataset[0]
    table = next((table for table in reversed(run.tables) if table.first_frame <= frame), run)
    log = table.beside(".mcap")
    path = str(log if log.exists() else table.path)
    return f"./{path}" if path.startswith("-") else path
