"""``roadperc-info``: what is in a log, whether it is whole, and what a replay would make of it."""

import argparse
from pathlib import Path

from roadperc_stream.cli.arguments import add_topic_argument
from roadperc_stream.cli.completers import LOGS, completed_by, files
from roadperc_stream.cli.plumbing import command_parser, parse, run

_EXAMPLE = """\
example:
  roadperc-info logs/sample.mcap
  roadperc-info bag.mcap --topic image=/front/rgb      as roadperc-replay would take it
  roadperc-info part_*.mcap                            also how they join as the parts of one log
  roadperc-info --json logs/*.mcap                     a JSON object and line per log, for scripts; times in ns

The keys of --json are the fields in roadperc_stream/info/facts.py; a log that cannot be opened gives "log" and "error".
Exit code 0: every log is whole; 1: one is cut, damaged or no log at all (the others are printed all the same).
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-info``: print what is known of logs."""
    arguments = parse(_parser(), argv)
    from roadperc_stream.info.listing import list_logs

    return run(lambda: list_logs(arguments.logs, arguments.topic, as_json=arguments.json))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "info",
        "Print what is in a log and whether the file is whole; which roles its channels fill, and what a\n"
        "replay has to do without; of a result, which configuration made it, and whether it is unchanged.",
        _EXAMPLE,
    )
    logs = parser.add_argument(
        "logs",
        metavar="LOG",
        type=Path,
        nargs="+",
        help="a log, input or result, also a damaged one; - is standard input",
    )
    add_topic_argument(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object a log, on a line of its own")
    completed_by(logs, files(*LOGS))
    return parser
