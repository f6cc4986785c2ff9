"""How a log is served to Foxglove."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PlaybackOptions:
    """How a log is served."""

    rate: float = 1.0
    """Log seconds per second."""
    loop: bool = False
    host: str = "127.0.0.1"
    port: int = 8765
    """0 for a free one."""
    start_s: float = 0.0
    """Where playback starts, counted from the log's first message."""
