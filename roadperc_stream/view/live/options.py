"""The options of playback, as ``ros2 bag play`` has them."""

import argparse
from dataclasses import dataclass, fields, replace
from typing import Final

from roadperc_stream.cli.plumbing import seconds
from roadperc_stream.view.live.playhead import FASTEST, SLOWEST

_HIGHEST_PORT: Final = 65535


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


_SERVING_OPTIONS: Final = tuple(field.name for field in fields(PlaybackOptions) if field.name != "start_s")


def add_serving_arguments(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """``--rate``, ``--loop``, ``--host`` and ``--port``, None where not given."""
    group = parser.add_argument_group("serving to Foxglove")
    group.add_argument("--rate", metavar="FACTOR", type=rate, help="speed of playback at first (default 1)")
    group.add_argument("--loop", action="store_true", default=None, help="at the end go back to where it started")
    group.add_argument("--host", metavar="ADDRESS", help="address to listen on (default 127.0.0.1: this machine only)")
    group.add_argument("--port", metavar="N", type=port, help="port to listen on (default 8765; 0 takes a free one)")
    return group


def add_playback_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of serving and ``--start``, for a command that plays a finished log."""
    group = add_serving_arguments(parser)
    group.add_argument("--start", metavar="SECONDS", type=seconds, help="from here, counted from the first message")


def serving_options(arguments: argparse.Namespace) -> PlaybackOptions:
    """What ``add_serving_arguments`` read, and the defaults of the others."""
    return PlaybackOptions(**{name: getattr(arguments, name) for name in given_options(arguments)})


def playback_options(arguments: argparse.Namespace) -> PlaybackOptions:
    """What ``add_playback_arguments`` read, and the defaults of the others."""
    return replace(serving_options(arguments), start_s=arguments.start or 0.0)


def given_options(arguments: argparse.Namespace) -> list[str]:
    """Names of the serving options on the command line: without a server they are wrong usage."""
    return [name for name in _SERVING_OPTIONS if getattr(arguments, name) is not None]


def rate(text: str) -> float:
    """An argument that is a speed the player has."""
    value = float(text)
    if not SLOWEST <= value <= FASTEST:
        raise argparse.ArgumentTypeError(f"{text}: expected {SLOWEST:g} to {FASTEST:g}")
    return value


def port(text: str) -> int:
    """An argument from 0 to 65535."""
    number = int(text)
    if not 0 <= number <= _HIGHEST_PORT:
        raise argparse.ArgumentTypeError(f"{text}: expected 0 to {_HIGHEST_PORT}")
    return number
