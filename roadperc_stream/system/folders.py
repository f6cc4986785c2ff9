"""What to do with a folder where a log is expected."""

import shlex
from pathlib import Path


def not_a_log(folder: Path) -> str:
    """Words for a folder that is named as a log: the logs within, or the command that makes one of a dump."""
    logs = sorted(folder.glob("*.mcap"))
    if logs:
        parts = f", or its {len(logs)} files as the parts of one: {folder}/*.mcap" if len(logs) > 1 else ""
        return f"{folder}: is a folder, expected a log, such as {logs[0]}{parts}"
    target = f"{folder if folder.name.strip('.') else folder.resolve().name}.mcap"
    command = shlex.join(("roadperc-convert", str(folder), target))
    return f"{folder}: is a folder, expected a log; a CARLA dump becomes one with: {command}"
