"""``roadperc-report``: print tables on one or more replays."""

import argparse
from pathlib import Path

from roadperc_stream.cli.completers import RUNS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, parse, part, run, whole_number

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap runs/base/sample.mcap
  roadperc-replay logs/sample.mcap runs/slow/sample.mcap --set lanes.hold_s=2
  roadperc-report runs/base/sample.mcap                one run, from the table of the log
  roadperc-report runs/                                both runs side by side, as base/sample and slow/sample
  roadperc-report 'runs/*/town*.metrics.parquet' --worst 10
  roadperc-report runs/ --html report.html             also a page with charts and pictures of the worst frames
  roadperc-report dataset                              the dataset of a batch, by configuration
  roadperc-report s3://bucket/dataset --by log,config  by log and configuration
  roadperc-report dataset --by lane_left_status        by any column
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-report``: print tables over finished runs."""
    parser = _parser()
    arguments = parse(parser, argv)
    datasets = [dataset for run_ in arguments.runs if (dataset := part("eval.dataset.place").dataset_at(run_))]
    if datasets or arguments.by:
        _require_one_dataset(parser, arguments, len(datasets))
        of_dataset = part("eval.dataset.report")
        if arguments.html:
            write = part("eval.html.dataset_page").write_dataset_page
            return run(lambda: write(arguments.html, datasets[0]))
        return run(lambda: of_dataset.print_dataset(datasets[0], arguments.by, arguments.worst))
    report = part("eval.report")
    write_page = part("eval.html.page").write_page if arguments.html else None
    return run(lambda: report.print_report(arguments.runs, arguments.worst, arguments.html, write_page))


def _require_one_dataset(parser: argparse.ArgumentParser, arguments: argparse.Namespace, datasets: int) -> None:
    """Exit with code 2 if options contradict each other."""
    if not datasets:
        parser.error("--by needs the OUT_DIR of a batch, a folder with runs.parquet and metrics/date=.../")
    if len(arguments.runs) > 1:
        parser.error("expected one OUT_DIR of a batch without any other RUN")


def _columns(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"{text!r}: expected names of columns, such as config,date")
    return names


def _parser() -> argparse.ArgumentParser:
    worst = part("eval.options").WORST_FRAMES
    parser = command_parser(
        "report",
        "Report on replays: coverage, accuracy if the log has truth, missing outputs, latency and the worst frames.\n"
        "Runs of one configuration are pooled and then listed. Runs of several configurations are shown side by\n"
        "side with the settings that differ. For the OUT_DIR of a batch, print the same over all logs, and the\n"
        "worst logs.",
        _EXAMPLE,
    )
    runs = parser.add_argument(
        "runs",
        metavar="RUN",
        nargs="+",
        help="OUT.metrics.parquet, an OUT.mcap with its table, a folder with tables, or a glob; or the OUT_DIR of a "
        "batch, which may be an address",
    )
    parser.add_argument(
        "--by",
        metavar="COLUMN[,COLUMN]",
        type=_columns,
        default=[],
        help="for the OUT_DIR of a batch: group by config (the default), log, date, or any columns of the metrics "
        "tables or of runs.parquet, such as lane_left_status or worker",
    )
    parser.add_argument(
        "--worst",
        metavar="N",
        type=whole_number,
        default=worst,
        help=f"list the N worst frames for each error; for the OUT_DIR of a batch, the N worst logs (default {worst})",
    )
    html = parser.add_argument(
        "--html",
        metavar="FILE.html",
        type=Path,
        help="also write one offline page with summary, charts, trajectory and pictures of the worst frames; "
        "an existing file is replaced",
    )
    completed_by(runs, files(*RUNS))
    completed_by(html, files(".html"))
    return parser
