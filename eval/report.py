"""``roadperc-report``: what came out of one replay or many, on the terminal."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import run, whole_number
from roadperc_stream.cli.terminal import console_for, print_lines
from roadperc_stream.errors import TableError

from .html.page import write_page
from .runs import find_runs
from .summary import summarise_all, summarise_run
from .terminal import print_empty, print_one, print_several

WORST_FRAMES = 3
_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/base/sample.mcap
  roadperc-replay logs/sample.mcap runs/slow/sample.mcap --set lanes.hold_s=2
  roadperc-report runs/base/sample.mcap        one run, from the table beside the log
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
        description="Print what came out of replays: what was seen in how many frames, how right it is where\n"
        "the log carries truth, how long it took, and the worst frames.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "runs",
        metavar="RUN",
        nargs="+",
        help="a metrics table (OUT.metrics.parquet), the OUT.mcap it lies beside, a folder with tables, or a glob",
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
        print_several(console, *summarise_all(filled, worst))
    if html is not None:
        print_lines(console, "", f"page   {html}", unbroken=True)
