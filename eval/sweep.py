"""Logs under every combination of some settings, and which setting is best for which metric."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from roadperc_stream.cli.arguments import time_range_of
from roadperc_stream.core.config import load_config
from roadperc_stream.core.folders import not_a_log
from roadperc_stream.core.text import print_line
from roadperc_stream.errors import LogError
from roadperc_stream.output.terminal import console_for, frame_progress, print_lines, print_table
from roadperc_stream.schemas.roles import parse_topic_options

from .sweeping.dataset import dataset, describe, table_names, tables
from .sweeping.influence import without_influence
from .sweeping.processes import sweep_logs
from .sweeping.ranking import METRICS, scores
from .sweeping.settings import Combination, combinations, reference_of
from .sweeping.sweep_log import Job
from .sweeping.tables import LEGEND, best_settings, effects, values_taken, without_effect


def sweep(arguments: argparse.Namespace) -> None:
    """Replay logs under every combination of settings and print which is best.

    Raises:
        RoadpercError: a log cannot be replayed, a setting does not fit, or the dataset cannot be written.
    """
    made = combinations(arguments.config, arguments.set, arguments.vary)
    reference = reference_of(made, load_config(arguments.config, tuple(arguments.set)))
    _require_files(arguments.logs)
    with dataset(arguments.out, arguments.force) as folder:
        jobs = _jobs(arguments, folder, made)
        with frame_progress(f"{len(made)} combinations", enabled=True) as bar:
            notes = sweep_logs(jobs, arguments.jobs, bar)
        describe(folder, made, arguments.logs)
    for job, texts in zip(jobs, notes, strict=True):
        for note in texts:
            print_line(f"note: {job.source.name}: {note}")
    _print(arguments.out, made, reference)


def _require_files(logs: Sequence[Path]) -> None:
    """Fail at once rather than after the logs before it have been replayed."""
    for path in logs:
        if not path.is_file():
            raise LogError(not_a_log(path) if path.is_dir() else f"{path}: no such file")


def _jobs(arguments: argparse.Namespace, folder: Path, made: tuple[Combination, ...]) -> list[Job]:
    overrides, time_range = parse_topic_options(arguments.topic), time_range_of(arguments)
    named = zip(arguments.logs, table_names(arguments.logs), strict=True)
    return [Job(path, name, folder, made, overrides, time_range) for path, name in named]


def _print(folder: Path, made: Sequence[Combination], reference: Combination) -> None:
    console, files = console_for(sys.stdout), tables(folder)
    found = [(metric, scores(files, made, metric)) for metric in METRICS]
    heading = f"{len(files)} tables in {folder}: {len(made)} settings, reference {reference}"
    print_lines(console, heading, *values_taken(made), unbroken=True)
    for table in (best_settings(found, made, reference), *(effects(found, made, key) for key in reference.settings)):
        print_table(console, table)
    idle = (f"{key} changed nothing" for key in without_influence(folder, files, made))
    print_lines(console, "", *idle, without_effect(found), *LEGEND)
