"""Arguments that several commands share."""

import argparse
import math
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Final

from roadperc_stream.cli.completers import completed_by, files, settings, topics, words
from roadperc_stream.cli.plumbing import number, seconds, whole_number
from roadperc_stream.schemas.topics import NEEDS, STAGES, switched_off
from roadperc_stream.view.live import FASTEST, SLOWEST, PlaybackOptions

if TYPE_CHECKING:
    from roadperc_stream.config import ReplayConfig
    from roadperc_stream.eval.results import ResultFiles
    from roadperc_stream.system.time import TimeRange


SEED: Final = number(0, 2**63 - 1, "a whole number of 0 or more", int)
"""The type of ``--seed``."""
ABOUT_LOG: Final = ("fov", "height", "calibration", "labels")
"""Options of ``add_log_arguments``."""
_field_of_view = number(1e-3, math.nextafter(180, 0), "degrees below 180")
_height = number(0.05, 100, "metres from 0.05 to 100")


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


def add_log_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what a log does not: its camera and its labels."""
    group = parser.add_argument_group("instead of what the log says")
    add_camera_arguments(group, "default: that of the log")
    labels = group.add_argument("--labels", type=Path, metavar="FILE", help="TOML file with known labels for others")
    completed_by(labels, files(".toml"))


def add_camera_arguments(parser: argparse._ActionsContainer, default: str) -> None:
    """Add ``--fov``, ``--height`` and ``--calibration``."""
    add = parser.add_argument
    add("--fov", type=_field_of_view, metavar="DEGREES", help="horizontal field of view")
    add("--height", type=_height, metavar="METRES", help="height of a level camera above the road")
    calibration = add(
        "--calibration",
        type=Path,
        metavar="FILE",
        help=f"calibration of the camera: camera_info YAML of ROS, or JSON ({default})",
    )
    completed_by(calibration, files(".yaml", ".yml", ".json"))


def about_log(cfg: "ReplayConfig", arguments: argparse.Namespace) -> "ReplayConfig":
    """The configuration with what the options say about the log.

    Raises:
        RoadpercError: a file of the options is wrong.
    """
    from roadperc_stream.config import ReplayConfig
    from roadperc_stream.config.calibration import CalibrationConfig
    from roadperc_stream.config.loading import load_labels

    path: Path | None = arguments.calibration
    found = CalibrationConfig()
    if path is not None:
        from roadperc_stream.tools.layouts.dump import calibration_in

        known = calibration_in(path).model_dump(include=set(CalibrationConfig.model_fields))
        found = CalibrationConfig.model_validate(known)
    found = found.with_options(path, arguments.fov, arguments.height)
    labels: Path | None = vars(arguments).get("labels")
    given = ReplayConfig(calibration=found, labels=load_labels(labels) if labels else {}).with_log_facts(cfg)
    return cfg.model_copy(update={name: getattr(given, name) for name in ("calibration", "labels")})


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


def add_result_file_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``, ``--markdown`` and ``--junit`` to a command of the evaluation."""
    group = parser.add_argument_group("results for other programs")
    for option, suffix, text in (
        ("--json", ".json", "write one nested object"),
        ("--markdown", ".md", "append a summary for merge requests to a file such as $GITHUB_STEP_SUMMARY"),
        ("--junit", ".xml", "write JUnit XML for GitLab, GitHub and Jenkins"),
    ):
        action = group.add_argument(option, metavar="FILE", type=Path, help=text)
        completed_by(action, files(suffix))


def result_files_of(arguments: argparse.Namespace) -> "ResultFiles":
    """The files that ``--json``, ``--markdown`` and ``--junit`` name."""
    from roadperc_stream.eval.results import ResultFiles

    return ResultFiles(arguments.json, arguments.markdown, arguments.junit)


def time_range_of(arguments: argparse.Namespace) -> "TimeRange":
    """The part of the log that the options select.

    Raises:
        ConfigError: it ends before it starts.
    """
    from roadperc_stream.system.time import TimeRange

    return TimeRange(arguments.start, arguments.end, arguments.frames)


def config_of(arguments: argparse.Namespace) -> "ReplayConfig":
    """The configuration that ``--config``, ``--set``, ``--only`` and the options about the log give together.

    Raises:
        RoadpercError: a file cannot be read, or a setting does not fit.
    """
    from roadperc_stream.config import load_config

    only = arguments.only or STAGES
    off = tuple(switched_off(stage) for stage in STAGES if stage not in only)
    return about_log(load_config(arguments.config, (*arguments.set, *off)), arguments)


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
