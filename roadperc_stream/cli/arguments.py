"""The values that shared options give together: a configuration, a part of a log, files of results."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from roadperc_stream.cli.options import SERVING
from roadperc_stream.schemas.topics import STAGES, switched_off
from roadperc_stream.view.live import PlaybackOptions

if TYPE_CHECKING:
    from roadperc_stream.config import ReplayConfig
    from roadperc_stream.eval.results import ResultFiles
    from roadperc_stream.system.time import TimeRange


def config_of(arguments: argparse.Namespace) -> "ReplayConfig":
    """The configuration that ``--config``, ``--set``, ``--only`` and the options about the log give together.

    Raises:
        RoadpercError: a file cannot be read, or a setting does not fit.
    """
    from roadperc_stream.config import load_config

    only = arguments.only or STAGES
    off = tuple(switched_off(stage) for stage in STAGES if stage not in only)
    return about_log(load_config(arguments.config, (*arguments.set, *off)), arguments)


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
        from roadperc_stream.tools.readers.calibration_file import load_calibration

        known = load_calibration(path).model_dump(include=set(CalibrationConfig.model_fields))
        found = CalibrationConfig.model_validate(known)
    found = found.with_options(path, arguments.fov, arguments.height)
    labels: Path | None = vars(arguments).get("labels")
    given = ReplayConfig(calibration=found, labels=load_labels(labels) if labels else {}).with_log_facts(cfg)
    return cfg.model_copy(update={name: getattr(given, name) for name in ("calibration", "labels")})


def time_range_of(arguments: argparse.Namespace) -> "TimeRange":
    """The part of the log that the options select.

    Raises:
        ConfigError: it ends before it starts.
    """
    from roadperc_stream.system.time import TimeRange

    return TimeRange(arguments.start, arguments.end, arguments.frames)


def result_files_of(arguments: argparse.Namespace) -> "ResultFiles":
    """The files that ``--json``, ``--markdown`` and ``--junit`` name."""
    from roadperc_stream.eval.results import ResultFiles

    return ResultFiles(arguments.json, arguments.markdown, arguments.junit)


def serving_options(arguments: argparse.Namespace) -> PlaybackOptions:
    """The options of a server, with defaults."""
    return PlaybackOptions(**{name: getattr(arguments, name) for name in given_options(arguments)})


def given_options(arguments: argparse.Namespace) -> list[str]:
    """Names of the serving options on the command line; without a server they are wrong usage."""
    return [name for name in SERVING if getattr(arguments, name) is not None]
