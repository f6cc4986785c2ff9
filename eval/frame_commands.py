"""The command that shows one frame of a run."""

import shlex

from .runs import Run


def view_command(run: Run, frame: int) -> str:
    """``roadperc-view OUT.mcap --frame N`` for a run."""
    return f"roadperc-view {shlex.quote(str(run.beside('.mcap')))} --frame {frame}"


def view_pair_command(base: Run, new: Run, frame: int) -> str:
    """The command that shows one frame of two runs side by side."""
    logs = (shlex.quote(str(run.beside(".mcap"))) for run in (base, new))
    return f"roadperc-view {' '.join(logs)} --frame {frame}"


def view_dataset_command(address: str, log: str, frame: int, config: str = "") -> str:
    """The command that shows one frame of a log in a dataset; ``log`` is its name in the report or its ``log_id``."""
    configs = ("--config", config) if config else ()
    return shlex.join(["roadperc-view", address, "--log", log, *configs, "--frame", str(frame)])
