"""``roadperc-info``: what is in a log, whether it is whole, and what a replay would make of it."""

import argparse
from pathlib import Path

from roadperc_stream.cli.arguments import add_topic_argument
from roadperc_stream.cli.completers import LOGS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, parse, run

_EXAMPLE = """\
example:
  roadperc-info logs/sample.mcap
  roadperc-info bag.mcap --topic image=/front/rgb      as roadperc-replay would read it
  roadperc-info part_*.mcap                            also how they join into one log
  roadperc-info --json logs/*.mcap                     a line of JSON per log, for scripts; times in ns
  roadperc-info cut.mcap --recover whole.mcap          save the readable part of a damaged log

The keys of --json are the fields in roadperc_stream/info/facts.py; a log that cannot be opened gives "log" and "error".
Exit code 0: every log is complete; 1: one is cut, damaged or not a log (the others are still printed).
With --recover 0: part of the log was saved; 1: nothing was saved.
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-info``: print what is known of logs."""
    parser = _parser()
    arguments = parse(parser, argv)
    if arguments.recover is not None:
        _require_alone(parser, arguments)
        from roadperc_stream.info.listing import recover_log

        return run(lambda: recover_log(arguments.logs[0], arguments.recover, force=arguments.force))
    if arguments.force:
        parser.error("--force: only with --recover")
    from roadperc_stream.info.listing import list_logs

    return run(lambda: list_logs(arguments.logs, arguments.topic, as_json=arguments.json))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "info",
        "Print the content of a log, whether the file is complete, which roles its channels fill, and which roles\n"
        "are missing. For a result log, also print its configuration and whether it was changed.",
        _EXAMPLE,
    )
    logs = parser.add_argument(
        "logs",
        metavar="LOG",
        type=Path,
        nargs="+",
        help="an input or result log, damaged ones too; - for standard input",
    )
    add_topic_argument(parser)
    parser.add_argument("--json", action="store_true", help="print one line of JSON per log")
    recover = parser.add_argument(
        "--recover", metavar="OUT.mcap", type=Path, help="write the readable part of a damaged LOG as a new log"
    )
    parser.add_argument("--force", action="store_true", help="replace an existing OUT.mcap")
    completed_by(logs, files(*LOGS))
    completed_by(recover, files(".mcap"))
    return parser


def _require_alone(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """End with a line on the usage, where something stands beside ``--recover`` that it has no use for."""
    if len(arguments.logs) > 1:
        parser.error(f"--recover: expected one LOG, found {len(arguments.logs)}")
    for option in ("json", "topic"):
        if getattr(arguments, option):
            parser.error(f"--{option}: not together with --recover")
