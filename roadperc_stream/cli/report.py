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
  roadperc-report dataset                      what roadperc-batch made: by configuration, and the worst logs
  roadperc-report s3://bucket/dataset --by log,config
  roadperc-report dataset --by lane_left_status        or any column of the metrics tables or of runs.parquet
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-report``: print tables over finished runs."""
    parser = _parser()
    arguments = parse(parser, argv)
    datasets = [dataset for run_ in arguments.runs if (dataset := part("eval.dataset.place").dataset_at(run_))]
    if datasets or arguments.by:
        _require_one_dataset(parser, arguments, len(datasets))
        of_dataset = part("eval.dataset.report")
        return run(lambda: of_dataset.print_dataset(datasets[0], arguments.by, arguments.worst))
    report = part("eval.report")
    write_page = part("eval.html.page").write_page if arguments.html else None
    return run(lambda: report.print_report(arguments.runs, arguments.worst, arguments.html, write_page))


def _require_one_dataset(parser: argparse.ArgumentParser, arguments: argparse.Namespace, datasets: int) -> None:
    """End with exit code 2 where options do not go together."""
    if not datasets:
        parser.error("--by: expected a batch's dataset, a folder with runs.parquet and metrics/date=.../")
    if len(arguments.runs) > 1:
        parser.error("a batch's dataset is reported by itself: expected no other RUN beside it")
    if arguments.html:
        parser.error("--html: the page is about runs of a log or some, not about a batch's dataset; name tables in it")


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
        "Runs of one configuration and version are pooled and then listed. Runs of different configurations are\n"
        "shown side by side with the settings that differ. For a dataset of roadperc-batch: the same over all logs,\n"
        "by configuration or any column, and the worst logs.",
        _EXAMPLE,
    )
    runs = parser.add_argument(
        "runs",
        metavar="RUN",
        nargs="+",
        help="a metrics table (OUT.metrics.parquet), the OUT.mcap it lies next to, a folder with tables, or a glob; or "
        "the OUT_DIR of a batch, which may be an address",
    )
    parser.add_argument(
        "--by",
        metavar="COLUMN[,COLUMN]",
        type=_columns,
        default=[],
        help="of a batch's OUT_DIR: group by config (the default where there are several), log, date, or any columns "
        "of the metrics tables or of runs.parquet, such as lane_left_status or worker",
    )
    parser.add_argument(
        "--worst",
        metavar="N",
        type=whole_number,
        default=worst,
        help=f"worst frames listed for each error; of a batch's OUT_DIR worst logs, their frames (default {worst})",
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
