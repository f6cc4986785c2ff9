"""``roadperc-sweep``: logs under every combination of some settings, and which setting is best for which metric."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import frame_progress, run, whole_number
from roadperc_stream.cli.replay import add_input_arguments, cut_of
from roadperc_stream.cli.terminal import console_for, print_lines, print_table
from roadperc_stream.core.config import load_config
from roadperc_stream.errors import LogError
from roadperc_stream.schemas.roles import parse_topic_options

from .sweeping.dataset import dataset, describe, table_names, tables
from .sweeping.processes import sweep_logs
from .sweeping.ranking import METRICS, scores
from .sweeping.replaying import Job
from .sweeping.settings import Combination, combinations, reference_of, varied
from .sweeping.tables import LEGEND, best_settings, effects, without_effect

_EXAMPLE = """\
example:
  roadperc-sweep logs/sample.mcap --vary lanes.process_noise=0.1,0.3,1 --vary surface.inlier_m=0.03,0.05

replays the sample under all six combinations, writes sweep/ with a metrics table for each, the settings as columns
(pl.scan_parquet("sweep/**/*.parquet")), and prints the best setting for each metric. roadperc-report reads sweep/ too.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-sweep``: replay logs under every combination of settings and print which is best."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    _refuse_contradictions(parser, arguments)
    return run(lambda: _sweep(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-sweep",
        description="Replay logs under every combination of some settings, each log read and decoded once, write one\n"
        "dataset of metrics with the settings as columns, and print which setting is best for which metric.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", metavar="IN.mcap", type=Path, nargs="+")
    parser.add_argument(
        "--vary",
        metavar="KEY=A,B,...",
        type=varied,
        action="append",
        required=True,
        help="a setting and the values it takes; several times for all combinations",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("sweep"), help="the dataset (default: sweep)")
    add_input_arguments(parser)
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=whole_number,
        default=os.cpu_count() or 1,
        help="logs replayed at the same time (default: one for each processor)",
    )
    parser.add_argument("--force", action="store_true", help="replace DIR, where it is a former sweep")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _refuse_contradictions(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """End with a line on the usage, where an argument takes back what another one says."""
    keys = [item.key for item in arguments.vary]
    for key in keys:
        if keys.count(key) > 1:
            parser.error(f"argument --vary: {key} is varied twice")
    logs = [path.resolve() for path in arguments.logs]
    for path in arguments.logs:
        if logs.count(path.resolve()) > 1:
            parser.error(f"argument IN.mcap: {path} is given twice")


def _sweep(arguments: argparse.Namespace) -> None:
    made = combinations(arguments.config, arguments.set, arguments.vary)
    reference = reference_of(made, load_config(arguments.config, tuple(arguments.set)))
    _require_files(arguments.logs)
    with dataset(arguments.out, arguments.force) as folder:
        jobs = _jobs(arguments, folder, made)
        with frame_progress(f"{len(made)} combinations", enabled=True) as bar:
            notes = sweep_logs(jobs, arguments.jobs, bar)
        describe(folder, made, arguments.logs)
    for job, said in zip(jobs, notes, strict=True):
        for note in said:
            print(f"note: {job.source.name}: {note}")
    _print(arguments.out, made, reference)


def _require_files(logs: Sequence[Path]) -> None:
    """Say at once what would else be said after the logs before it have been replayed."""
    for path in logs:
        if not path.is_file():
            raise LogError(f"{path}: no such file")


def _jobs(arguments: argparse.Namespace, folder: Path, made: tuple[Combination, ...]) -> list[Job]:
    overrides, cut = parse_topic_options(arguments.topic), cut_of(arguments)
    named = zip(arguments.logs, table_names(arguments.logs), strict=True)
    return [Job(path, name, folder, made, overrides, cut) for path, name in named]


def _print(folder: Path, made: Sequence[Combination], reference: Combination) -> None:
    console, files = console_for(sys.stdout), tables(folder)
    found = [(metric, scores(files, made, metric)) for metric in METRICS]
    said = f"{len(files)} tables in {folder}: {len(made)} settings, reference {reference}"
    print_lines(console, said, unbroken=True)
    for table in (best_settings(found, made, reference), *(effects(found, made, key) for key in reference.settings)):
        print_table(console, table)
    print_lines(console, "", without_effect(found), *LEGEND)
