"""The commands that show a frame of a run; the user can paste them into a shell."""

import shlex
from collections.abc import Iterable

from .runs import Run


def view_command(run: Run, frame: int) -> str:
    """``roadperc-view OUT.mcap --frame N`` for a run; without the log its table, for a batch its dataset."""
    return view_pair_command(run, run, frame)


def view_pair_command(base: Run, new: Run, frame: int) -> str:
    """The command that shows one frame of two runs side by side."""
    arguments = dict.fromkeys(_argument(run, frame) for run in (base, new))
    configs = dict.fromkeys(run.dataset[1] for run in (base, new) if run.dataset)
    log = base.name.removesuffix(f" {base.dataset[1]}") if base.dataset else ""  # as among several configurations
    return _command(arguments, log, configs, frame)


def view_dataset_command(address: str, log: str, frame: int, config: str = "") -> str:
    """The command that shows one frame of a log in a dataset; ``log`` is its name in the report or its ``log_id``."""
    return _command([address], log, [config] if config else [], frame)


def _command(arguments: Iterable[str], log: str, configs: Iterable[str], frame: int) -> str:
    options = [*(["--log", log] if log else []), *(word for config in configs for word in ("--config", config))]
    return shlex.join(["roadperc-view", *arguments, *options, "--frame", str(frame)])


def _argument(run: Run, frame: int) -> str:
    """The dataset, the log if it exists, or the table of a run."""
    if run.dataset:
        return run.dataset[0]
    table = run.table_of(frame)
    log = table.beside(".mcap")
    path = str(log if log.exists() else table.path)
    return f"./{path}" if path.startswith("-") else path
