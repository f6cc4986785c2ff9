"""``roadperc-report``: what came out of one replay or many."""

import argparse
from pathlib import Path

from roadperc_stream.cli.completers import RUNS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, parse, part, run, whole_number

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
    arguments = parse(_parser(), argv)
    report = part("eval.report")
    write_page = part("eval.html.page").write_page if arguments.html else None
    return run(lambda: report.print_report(arguments.runs, arguments.worst, arguments.html, write_page))


def _parser() -> argparse.ArgumentParser:
    worst = part("eval.options").WORST_FRAMES
    parser = command_parser(
        "report",
        "Print what came out of replays: coverage, accuracy where the log carries truth, missing outputs,\n"
        "latency and the worst frames. Runs of one configuration and version are pooled and then listed; runs of\n"
        "different ones stand side by side below the settings that differ, and nothing is computed over both.",
        _EXAMPLE,
    )
    runs = parser.add_argument(
        "runs",
        metavar="RUN",
        nargs="+",
        help="a metrics table (OUT.metrics.parquet), the OUT.mcap it lies next to, a folder with tables, or a glob",
    )
    parser.add_argument(
        "--worst",
        metavar="N",
        type=whole_number,
        default=worst,
        help=f"worst frames listed for each error (default {worst})",
    )
    html = parser.add_argument(
        "--html",
        metavar="FILE.html",
        type=Path,
        help="also write one self-contained page: summary, charts, trajectory, pictures of the worst frames; "
        "replaces an earlier one",
    )
    completed_by(runs, files(*RUNS))
    completed_by(html, files(".html"))
    return parser
