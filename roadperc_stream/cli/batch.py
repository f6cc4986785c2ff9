"""``roadperc-batch``: many logs into one dataset."""

import argparse
import math
import re
from pathlib import Path
from typing import Final

from roadperc_stream.cli.completers import LOGS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import REPLAY, add, add_about_log, add_shared, command_parser, parse
from roadperc_stream.cli.values import number, positive_seconds, whole_number

_EXAMPLE: Final = """\
example:
  roadperc-batch dataset logs/                          replay every log below logs/, on all cores
  roadperc-batch dataset logs/                          again: replay only new and changed logs
  roadperc-batch dataset logs/ --set lanes.hold_s=2     add a second configuration to the dataset
  roadperc-report dataset                               evaluate the dataset
  roadperc-batch dataset 'logs/2026-*/*.mcap' @more.txt --join '_\\d+$' --recover
  roadperc-batch s3://bucket/dataset s3://bucket/logs/ --ray auto --memory 4GB

In Python: polars.scan_parquet("dataset/metrics/**/*.parquet", hive_partitioning=True); docs/evaluation.md reads
tables of several versions
"""
_UNITS: Final = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


def main(argv: list[str] | None = None) -> int:
    """``roadperc-batch``: replay many logs into one dataset."""
    parser = _parser()
    arguments = parse(parser, argv, intermixed=True)
    if arguments.results_only and not arguments.keep_logs:
        parser.error("--results-only needs --logs")
    if arguments.ray not in {None, "local"} and arguments.jobs is not None:
        parser.error("--jobs cannot be combined with --ray ADDRESS; the cluster sets the number")
    from roadperc_stream.cli.batch_logs import batch_logs

    return run(lambda: batch_logs(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "batch",
        "Replay many logs into one dataset. OUT_DIR/metrics has a row per frame, OUT_DIR/objects a row per\n"
        "detection, OUT_DIR/runs.parquet a row per log, also for failed logs. Run the same command again to\n"
        "replay only new, changed and interrupted logs.",
        _EXAMPLE,
    )
    out = "folder of the dataset, or an address such as s3://bucket/dataset"
    add(parser, "out", metavar="OUT_DIR", help=out, completer=files())
    add(
        parser,
        "logs",
        metavar="LOG",
        nargs="+",
        help="a log, a folder, a glob in quotes, an address, or @FILE with one of these per line",
        completer=files(*LOGS),
    )
    add(
        parser,
        "--join",
        metavar="PATTERN",
        type=_pattern,
        help="join the files of one folder whose names are equal without this regular expression into one log; "
        "'_\\d+$' joins town_0.mcap and town_1.mcap",
    )
    add_shared(parser, *REPLAY, "only")
    add_about_log(parser)
    _add_dataset(parser.add_argument_group("dataset"))
    _add_workers(parser.add_argument_group("workers and limits"))
    return parser


def _add_dataset(group: argparse._ArgumentGroup) -> None:
    for option, text in (
        ("--results-only", "with --logs: store only results, without the input's messages"),
        ("--retry-failed", "retry damaged and empty logs, even if unchanged"),
        ("--verify", "detect changed logs by their content, not by size and time; slow"),
        ("--dry-run", "print the action and the reason for each log, and do nothing"),
        ("--fail-fast", "stop at the first log that fails"),
    ):
        add(group, option, action="store_true", help=text)
    add(group, "--logs", dest="keep_logs", action="store_true", help="also store the result logs in OUT_DIR/logs")
    add_shared(group, "recover", "contract")


def _add_workers(group: argparse._ArgumentGroup) -> None:
    jobs = "replay N logs at a time on this machine (default: one per core)"
    add(group, "--jobs", metavar="N", type=whole_number, help=jobs)
    ray = "run on the Ray cluster at this address; auto: the cluster of this machine; local: start a cluster here"
    add(group, "--ray", metavar="ADDRESS", help=ray)
    timeout = "stop a replay after this time (default: no limit)"
    add(group, "--timeout", metavar="SECONDS", type=positive_seconds, help=timeout)
    add(
        group,
        "--memory",
        metavar="SIZE",
        type=_bytes,
        default="2GB",
        help="stop a replay that needs more memory, such as 500MB or 4GiB (default 2GB); Ray reserves it for each log",
    )
    add(
        group,
        "--retries",
        metavar="N",
        type=number(0, math.inf, "a whole number", int),
        default=2,
        help="retries of a log that was unreachable or whose worker died (default 2)",
    )
    add(
        group,
        "--scratch",
        metavar="DIR",
        type=Path,
        help="folder for temporary files on each machine (default: OUT_DIR/.work, or $TMPDIR if OUT_DIR is an address)",
        completer=files(),
    )
    add_shared(group, "quiet")


def _pattern(text: str) -> "re.Pattern[str]":
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a regular expression: {error}") from None
    if pattern.match(""):
        raise argparse.ArgumentTypeError(f"{text!r}: matches every name; expected a pattern such as _\\d+$")
    return pattern


def _bytes(text: str) -> int:
    found = re.fullmatch(r"([0-9.]+)\s*([kmgt]i?)?b?", text.strip().lower())
    try:
        size = float(found[1]) * _UNITS[found[2] or ""] if found else 0.0
    except ValueError:
        size = 0.0
    if size < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a size such as 500MB or 4GiB")
    return int(size)
