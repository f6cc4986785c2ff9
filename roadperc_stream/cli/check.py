"""``roadperc-check``: judge runs by absolute limits, or write limits from reference runs."""

import argparse
from pathlib import Path

from roadperc_stream.cli.arguments import result_files_of
from roadperc_stream.cli.completers import RUNS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_result_files, add_shared, command_parser, parse

_EXAMPLE = """\
example:
  roadperc-replay logs/sample.mcap out.mcap
  roadperc-check out.mcap                               by the default criteria
  roadperc-check out.mcap --init criteria.toml          write limits from a good run
  roadperc-check out.mcap --criteria criteria.toml --junit check.xml
  roadperc-check dataset --criteria criteria.toml       all logs of a batch

criteria, in TOML:
  [[criterion]]
  metric = "lane_left_error_m"         or column = "..."; docs/checks.md lists all keys
  statistic = "p95"
  most = 0.1
  least_coverage = 0.9
  filter = "lane_left_status = 'measured'"

exit codes:
  0  every criterion passed or is skipped, and at least one passed
  1  a criterion failed
  2  wrong usage
  3  an error: a file cannot be read, a criterion does not fit, a log has no result, or every criterion is skipped
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-check``: print the criteria that failed, with the command that shows the worst frame of each."""
    parser = _parser()
    arguments = parse(parser, argv)
    _require_one_task(parser, arguments)
    from roadperc_stream.eval.check.check import check, init_criteria
    from roadperc_stream.eval.criteria import DEFAULT_CRITERIA

    runs, path, criteria = arguments.runs, arguments.init, arguments.criteria or DEFAULT_CRITERIA
    if path is not None:
        return run(lambda: init_criteria(runs, path, force=arguments.force), "check")
    return run(lambda: check(runs, criteria, result_files_of(arguments)), "check")


def _require_one_task(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Exit with code 2 if options contradict each other."""
    if arguments.init is None:
        if arguments.force:
            parser.error("--force belongs to --init")
        return
    for option in ("criteria", "json", "markdown", "junit"):
        if getattr(arguments, option) is not None:
            parser.error(f"--init writes criteria and checks nothing; remove --{option}")


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "check",
        "Check finished runs against absolute limits. Each criterion is passed, failed, or skipped with the reason.\n"
        "A failed criterion names its worst frame and the command that shows it.",
        _EXAMPLE,
    )
    add(
        parser,
        "runs",
        metavar="RUN",
        nargs="+",
        help="OUT.metrics.parquet, an OUT.mcap with its table, a folder with tables, a glob, or the OUT_DIR of a "
        "batch; all runs are judged together",
        completer=files(*RUNS),
    )
    criteria = "the criteria; without this option those of the package"
    add(parser, "--criteria", metavar="FILE.toml", type=Path, help=criteria, completer=files(".toml"))
    init = "write criteria with the limits that these runs reach"
    add(parser, "--init", metavar="FILE.toml", type=Path, help=init, completer=files(".toml"))
    add_shared(parser, force="with --init: replace an existing file")
    add_result_files(parser)
    return parser
