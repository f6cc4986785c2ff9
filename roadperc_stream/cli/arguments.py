"""Arguments that several commands share."""

import argparse
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Final

from roadperc_stream.cli.completers import completed_by, files, settings, topics, words
from roadperc_stream.cli.plumbing import number, seconds, whole_number
from roadperc_stream.schemas.topics import NEEDS, STAGES, switched_off
from roadperc_stream.view.live import FASTEST, SLOWEST, PlaybackOptions

if TYPE_CHECKING:
    from roadperc_stream.config import ReplayConfig
    from roadperc_stream.system.time import TimeRange


SEED: Final = number(0, 2**63 - 1, "a whole number of 0 or more", int)
"""The type of ``--seed``."""


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of every command that replays: settings, topics and the part of the log."""
    add = parser.add_argument
    config = add("--config", metavar="FILE", type=Path, help="read settings from this TOML file")
    setting = add("--set", metavar="KEY=VALUE", action="append", default=[], help="change one setting; overrides FILE")
    add_topic_argument(parser)
    add("--start", metavar="SECONDS", type=seconds, help="start this long after the first message")
    add("--end", metavar="SECONDS", type=seconds, help="end this long after the first message")
    add("--frames", metavar="N", type=whole_number, help="replay at most N frames")
    completed_by(config, files(".toml"))
    completed_by(setting, settings)


def add_topic_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--topic``, for every command that reads an input log."""
    action = parser.add_argument(
        "--topic",
        metavar="ROLE=/NAME",
        action="append",
        default=[],
        help="use this topic for a role, such as image=/front/rgb",
    )
    completed_by(action, topics)


def add_only_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--only``, for commands that run all stages by default."""
    action = parser.add_argument(
        "--only",
        metavar="STAGES",
        type=_stages,
        help=f"run only these stages, and the stages that they need: {','.join(STAGES)}; "
        "a log without depth needs stereo",
    )
    completed_by(action, words(STAGES))


def _stages(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    unknown = [name for name in names if name not in STAGES]
    if unknown:
        raise argparse.ArgumentTypeError(f"no stage {unknown[0]!r}; stages: {', '.join(STAGES)}")
    return names + tuple(needed for name in names for needed in NEEDS.get(name, ()))


def add_machine_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``, ``--markdown`` and ``--junit`` to a command of the evaluation."""
    group = parser.add_argument_group("results for other programs")
    for option, suffix, text in (
        ("--json", ".json", "write one nested object"),
        ("--markdown", ".md", "append a summary for merge requests to a file such as $GITHUB_STEP_SUMMARY"),
        ("--junit", ".xml", "write JUnit XML for GitLab, GitHub and Jenkins"),
    ):
        action = group.add_argument(option, metavar="FILE", type=Path, help=text)
        completed_by(action, files(suffix))


def time_range_of(arguments: argparse.Namespace) -> "TimeRange":
    """The part of the log that the options select.

    Raises:
        ConfigError: it ends before it starts.
    """
    from roadperc_stream.system.time import TimeRange

    return TimeRange(arguments.start, arguments.end, arguments.frames)


def config_of(arguments: argparse.Namespace) -> "ReplayConfig":
    """The configuration that ``--config``, ``--set`` and ``--only`` give together.

    Raises:
        ConfigError: the file cannot be read, or a setting does not fit.
    """
    from roadperc_stream.config import load_config

    only = arguments.only or STAGES
    off = tuple(switched_off(stage) for stage in STAGES if stage not in only)
    return load_config(arguments.config, (*arguments.set, *off))


_SERVING_OPTIONS: Final = tuple(field.name for field in fields(PlaybackOptions) if field.name != "start_s")


_rate = number(SLOWEST, FASTEST, f"{SLOWEST:g} to {FASTEST:g}")
_port = number(0, 65535, "0 to 65535", int)


def add_serving_arguments(parser: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Add ``--rate``, ``--loop``, ``--host`` and ``--port``; without an option its value is None."""
    group = parser.add_argument_group("serving to Foxglove")
    group.add_argument("--rate", metavar="FACTOR", type=_rate, help="playback speed (default 1)")
    group.add_argument("--loop", action="store_true", default=None, help="play the log again when it ends")
    group.add_argument("--host", metavar="ADDRESS", help="address to listen on (default 127.0.0.1, this machine only)")
    group.add_argument("--port", metavar="N", type=_port, help="port to listen on (default 8765; 0: any free port)")
    return group


def serving_options(arguments: argparse.Namespace) -> PlaybackOptions:
    """The options of ``add_serving_arguments``, with defaults."""
    return PlaybackOptions(**{name: getattr(arguments, name) for name in given_options(arguments)})


def given_options(arguments: argparse.Namespace) -> list[str]:
    """Names of the serving options on the command line; without a server they are wrong usage."""
    return [name for name in _SERVING_OPTIONS if getattr(arguments, name) is not None]
