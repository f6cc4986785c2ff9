"""``roadperc-sweep``: replay logs under every combination of settings, and print the best setting per metric."""

import argparse
import os
from pathlib import Path

from roadperc_stream.cli.arguments import add_input_arguments, add_machine_arguments
from roadperc_stream.cli.completers import LOGS, completed_by, files, varied_settings
from roadperc_stream.cli.plumbing import command_parser, parse, part, run, whole_number
from roadperc_stream.system.files import real_path

_EXAMPLE = """\
example:
  roadperc-sweep logs/sample.mcap --vary lanes.fit_strip_m=0.2,0.3,0.5 --vary surface.inlier_m=0.03,0.05

This replays the sample under all six combinations and writes a metrics table for each below sweep/, with the settings
as columns. Read them with pl.scan_parquet("sweep/**/*.parquet") or roadperc-report sweep/.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-sweep``: replay logs under every combination of settings."""
    parser = _parser()
    arguments = parse(parser, argv)
    keys = [item.key for item in arguments.vary]
    for key in keys:
        if keys.count(key) > 1:
            parser.error(f"argument --vary: {key} is varied twice")
    logs = [real_path(path) for path in arguments.logs]
    for path in arguments.logs:
        if logs.count(real_path(path)) > 1:
            parser.error(f"argument IN.mcap: {path} is given twice")
    sweeping = part("eval.sweep")
    return run(lambda: sweeping.sweep(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "sweep",
        "Replay logs under every combination of some settings, write the metrics to one dataset, and print the\n"
        "best setting for each metric. Each log is read and decoded once.",
        _EXAMPLE,
    )
    logs = parser.add_argument("logs", metavar="IN.mcap", type=Path, nargs="+", help="the logs to replay")
    vary = parser.add_argument(
        "--vary",
        metavar="KEY=A,B,...",
        type=part("eval.options").varied,
        action="append",
        required=True,
        help="a setting and its values; repeat the option for combinations of settings",
    )
    out = parser.add_argument(
        "--out", metavar="DIR", type=Path, default=Path("sweep"), help="folder of the dataset (default: sweep)"
    )
    add_input_arguments(parser)
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=whole_number,
        default=os.cpu_count() or 1,
        help="replay N logs at a time (default: one per processor)",
    )
    parser.add_argument("--force", action="store_true", help="replace DIR if it is the result of an earlier sweep")
    add_machine_arguments(parser)
    for action, completer in ((logs, files(*LOGS)), (vary, varied_settings), (out, files())):
        completed_by(action, completer)
    return parser
