"""What to do with a folder where a log is expected."""

import shlex
from pathlib import Path


def not_a_log(folder: Path) -> str:
    """Words for a folder that is named as a log: the log within, or the command that makes one of a dump."""
    log = min(folder.glob("*.mcap"), default=None)
    if log is not None:
        return f"{folder}: is a folder, expected a log, such as {log}"
    target = f"{folder if folder.name.strip('.') else folder.resolve().name}.mcap"
    command = shlex.join(("roadperc-convert", str(folder), target))
    return f"{folder}: is a folder, expected a log; a CARLA dump becomes one with: {command}"
