"""Arguments that several commands have in common."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from roadperc_stream.cli.completers import completed_by, files, settings, topics, words
from roadperc_stream.cli.plumbing import seconds, whole_number
from roadperc_stream.core.stage_names import NEEDS, STAGES, switched_off

if TYPE_CHECKING:
    from roadperc_stream.core.config import ReplayConfig
    from roadperc_stream.core.time import TimeRange


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """The settings, the topics and the part of the log: options of every command that replays."""
    add = parser.add_argument
    config = add("--config", metavar="FILE", type=Path, help="TOML file with any part of the settings")
    setting = add("--set", metavar="KEY=VALUE", action="append", default=[], help="one setting; wins over FILE")
    add_topic_argument(parser)
    add("--start", metavar="SECONDS", type=seconds, help="from here, counted from the first message")
    add("--end", metavar="SECONDS", type=seconds, help="up to here, counted from the first message")
    add("--frames", metavar="N", type=whole_number, help="at most so many frames")
    completed_by(config, files(".toml"))
    completed_by(setting, settings)


def add_topic_argument(parser: argparse.ArgumentParser) -> None:
    """``--topic``, for every command that reads an input log."""
    action = parser.add_argument(
        "--topic", metavar="ROLE=/NAME", action="append", default=[], help="the topic of a role"
    )
    completed_by(action, topics)


def add_only_argument(parser: argparse.ArgumentParser) -> None:
    """``--only``, for every command that replays with all stages unless said."""
    action = parser.add_argument(
        "--only",
        metavar="STAGES",
        type=_stages,
        help=f"some of {','.join(STAGES)}, with what they need; without a depth sensor name stereo among them",
    )
    completed_by(action, words(STAGES))


def _stages(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    unknown = [name for name in names if name not in STAGES]
    if unknown:
        raise argparse.ArgumentTypeError(f"no stage {unknown[0]!r}; stages: {', '.join(STAGES)}")
    return names + tuple(needed for name in names for needed in NEEDS.get(name, ()))


def time_range_of(arguments: argparse.Namespace) -> "TimeRange":
    """The part of the log that the options name.

    Raises:
        ConfigError: it ends before it starts.
    """
    from roadperc_stream.core.time import TimeRange

    return TimeRange(arguments.start, arguments.end, arguments.frames)


def config_of(arguments: argparse.Namespace) -> "ReplayConfig":
    """The configuration that ``--config``, ``--set`` and ``--only`` give together.

    Raises:
        ConfigError: the file cannot be read, or a setting does not fit.
    """
    from roadperc_stream.core.config import load_config

    only = arguments.only or STAGES
    off = tuple(switched_off(stage) for stage in STAGES if stage not in only)
    return load_config(arguments.config, (*arguments.set, *off))
