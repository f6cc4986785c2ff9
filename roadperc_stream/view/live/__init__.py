"""Serves finished logs and running replays to Foxglove with play, pause, seek and speed.

``cli.arguments`` reads the options below from a command line.
"""

from dataclasses import dataclass
from typing import Final

SLOWEST: Final = 1e-3
FASTEST: Final = 1e3
"""Log seconds per second."""


@dataclass(frozen=True)
class PlaybackOptions:
    """Options of the live server."""

    rate: float = 1.0
    """Log seconds per second."""
    loop: bool = False
    host: str = "127.0.0.1"
    port: int = 8765
    """0 for a free one."""
    start_s: float = 0.0
    """Where playback starts, counted from the log's first message."""
