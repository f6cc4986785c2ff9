"""``roadperc-report``: what came out of one replay or many, on the terminal."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from roadperc_stream import __version__
from roadperc_stream.command import run, whole_number
from roadperc_stream.errors import TableError
from roadperc_stream.terminal import console_for, print_lines

from .configurations import grouped, settings_table
from .html.page import write_page
from .names import name_columns, short_names
from .runs import Run, find_runs
from .summary import summarise_group, summarise_run
from .terminal import print_empty, print_one, print_several

WORST_FRAMES = 3
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/base/sample.mcap
  roadperc-replay logs/sample.mcap runs/slow/sample.mcap --set lanes.hold_s=2
  roadperc-report runs/base/sample.mcap        one run, from the table next to the log
  roadperc-report runs/                        both, side by side, as base/sample and slow/sample
  roadperc-report 'runs/*/town*.metrics.parquet' --worst 10
  roadperc-report runs/ --html report.html     and a page with charts and pictures of the worst frames
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-report``: print tables over finished runs."""
    arguments = _parser().parse_args(argv)
    return run(lambda: _report(arguments.runs, arguments.worst, arguments.html))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-report",
        description="Print what came out of replays: coverage, accuracy where the log carries truth, missing outputs,\n"
        "latency and the worst frames. Runs of one configuration and version are pooled and then listed; runs of\n"
        "different ones stand side by side below the settings that differ, and nothing is computed over both.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "runs",
        metavar="RUN",
        nargs="+",
        help="a metrics table (OUT.metrics.parquet), the OUT.mcap it lies next to, a folder with tables, or a glob",
    )
    parser.add_argument(
        "--worst",
        metavar="N",
        type=whole_number,
        default=WORST_FRAMES,
        help=f"worst frames listed for each error (default {WORST_FRAMES})",
    )
    parser.add_argument(
        "--html",
        metavar="FILE.html",
        type=Path,
        help="also write one self-contained page: summary, charts, trajectory, pictures of the worst frames; "
        "replaces an earlier one",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _report(arguments: Sequence[str], worst: int, html: Path | None) -> None:
    runs = find_runs(arguments)
    filled = [item for item in runs if item.frames]
    if not filled:
        raise TableError(f"{runs[0].path}: no frames in this table, so there is nothing to report")
    if html is not None:
        write_page(html, filled)  # before anything is printed: whoever reads the text may close the pipe early
    console = console_for(sys.stdout)
    print_empty(console, [item for item in runs if not item.frames])
    if len(filled) == 1:
        print_one(console, summarise_run(filled[0], worst))
    else:
        _print_several(console, filled, worst)
    if html is not None:
        print_lines(console, "", f"page   {html}", unbroken=True)


def _print_several(console: Console, runs: Sequence[Run], worst: int) -> None:
    names = short_names([run.name for run in runs], name_columns(console))
    groups = grouped([replace(run, name=names[run.name]) for run in runs])
    settings = settings_table({group.name: group.example for group in groups})
    print_several(console, [summarise_group(group, worst) for group in groups], settings, names)
