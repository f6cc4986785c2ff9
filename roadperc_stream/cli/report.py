"""``roadperc-report``: print tables on one or more replays."""

import argparse
from pathlib import Path

from roadperc_stream.cli.arguments import result_files_of
from roadperc_stream.cli.completers import RUNS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_result_files, command_parser, parse
from roadperc_stream.cli.values import whole_number

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/base/sample.mcap
  roadperc-replay logs/sample.mcap runs/slow/sample.mcap --set lanes.hold_s=2
  roadperc-report runs/base/sample.mcap                one run, from the table of the log
  roadperc-report runs/                                both runs side by side, as base/sample and slow/sample
  roadperc-report 'runs/*/town*.metrics.parquet' --worst 10
  roadperc-report runs/ --html report.html             also a page with charts and pictures of the worst frames
  roadperc-report dataset                              the dataset of a batch, by configuration
  roadperc-report runs/base/sample.mcap --by "floor(nearest_object_m / 10) * 10"
                                                       slices by a column or a polars SQL expression, the worst first
  roadperc-report runs/base/sample.mcap --by class     errors of the objects of each class
  roadperc-report s3://bucket/dataset --by log,config  by log and configuration
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-report``: print tables over finished runs."""
    parser = _parser()
    arguments = parse(parser, argv)
    from roadperc_stream.eval.dataset.place import dataset_at
    from roadperc_stream.eval.options import ReportOptions
    from roadperc_stream.eval.report.report import report

    if len(arguments.runs) > 1 and any(map(dataset_at, arguments.runs)):
        parser.error("expected one OUT_DIR of a batch without any other RUN")
    options = ReportOptions(arguments.by, arguments.full, arguments.worst, arguments.html)
    return run(lambda: report(arguments.runs, options, result_files_of(arguments)))


def _expressions(text: str) -> list[str]:
    """Split at the commas outside of brackets and quotes."""
    names, depth, quote = [""], 0, ""
    for character in text:
        quote = "" if character == quote else quote or (character if character in "'\"" else "")
        depth += 0 if quote else (character in "([") - (character in ")]")
        if character == "," and not depth and not quote:
            names.append("")
        else:
            names[-1] += character
    found = [name.strip() for name in names]
    if not all(found):
        raise argparse.ArgumentTypeError(f"{text!r}: expected columns or SQL expressions, such as config,date")
    return found


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.eval.options import WORST_FRAMES

    parser = command_parser(
        "report",
        "Report on replays: coverage, error and worst frame of each stage, and the latency. For two runs of a log,\n"
        "print the relevant differences; for more, a row for each. For the OUT_DIR of a batch, print a row for each\n"
        "configuration, and the worst logs. --full prints all tables.",
        _EXAMPLE,
    )
    add(
        parser,
        "runs",
        metavar="RUN",
        nargs="+",
        help="OUT.metrics.parquet, an OUT.mcap with its table, a folder with tables, or a glob; or the OUT_DIR of a "
        "batch, which may be an address",
        completer=files(*RUNS),
    )
    add(
        parser,
        "--by",
        metavar="EXPR[,EXPR]",
        type=_expressions,
        default=[],
        help="a row for each value of columns or polars SQL expressions, the worst first: log, class, date, "
        "lane_left_status, 'floor(distance_m / 10) * 10'",
    )
    add(parser, "--full", action="store_true", help="print all tables")
    add(
        parser,
        "--worst",
        metavar="N",
        type=whole_number,
        default=WORST_FRAMES,
        help="with --full, list the N worst frames for each error; for a batch, the N worst logs (default %(default)s)",
    )
    add(
        parser,
        "--html",
        metavar="FILE.html",
        type=Path,
        help="also write one offline page with summary, charts, trajectory and pictures of the worst frames; "
        "an existing file is replaced",
        completer=files(".html"),
    )
    add_result_files(parser)
    return parser
