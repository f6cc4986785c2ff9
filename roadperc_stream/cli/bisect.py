"""``roadperc-bisect``: find the shortest excerpt of a log for which a criterion still fails."""

import argparse
from pathlib import Path

from roadperc_stream.cli.arguments import add_topic_argument
from roadperc_stream.cli.completers import LOGS, completed_by, files, settings
from roadperc_stream.cli.plumbing import command_parser, parse, run
from roadperc_stream.system.process import EXIT_UNDECIDED

_EXAMPLE = """\
example:
  roadperc-bisect drive.mcap --criteria criteria.toml --set lanes.hold_s=3
  roadperc-view drive.bisect.mcap --frame 4             the command that it prints
  roadperc-bisect drive.mcap --criteria criteria.toml --config new.toml --base old.toml

After an interruption, the same command continues.

exit codes:
  0  a criterion fails, and the excerpt is written
  1  no criterion fails on the whole log; a skipped one does not fail
  2  wrong usage
  3  an error
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-bisect``: write the excerpt, and print the commands that show the failure."""
    arguments = parse(_parser(), argv)
    from roadperc_stream.eval.bisect.bisect import BisectOptions, bisect

    options = BisectOptions(
        arguments.log,
        arguments.criteria,
        arguments.out or Path(arguments.log.with_suffix(".bisect.mcap").name),
        arguments.criterion,
        arguments.config,
        arguments.set,
        arguments.base,
        arguments.topic,
        arguments.force,
    )
    return run(lambda: bisect(options), EXIT_UNDECIDED)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "bisect",
        "Find the shortest excerpt of a log for which a criterion still fails when the excerpt is replayed alone,\n"
        "and the fewest changed settings that it needs. Write the excerpt with its results.",
        _EXAMPLE,
    )
    add = parser.add_argument
    log = add("log", metavar="LOG", type=Path, help="the log to replay")
    criteria = add(
        "--criteria", metavar="FILE.toml", type=Path, required=True, help="the criteria, as in roadperc-check"
    )
    add("--criterion", metavar="NAME", help="the criterion; without this option the first one that fails")
    config = add("--config", metavar="FILE", type=Path, help="read settings from this TOML file")
    setting = add("--set", metavar="KEY=VALUE", action="append", default=[], help="change one setting; overrides FILE")
    base = add("--base", metavar="FILE", type=Path, help="the settings that work, instead of the default ones")
    add_topic_argument(parser)
    out = add("--out", metavar="FILE.mcap", type=Path, help="the excerpt (default: LOG.bisect.mcap in this folder)")
    add("--force", action="store_true", help="replace an existing excerpt")
    for action, completer in ((log, files(*LOGS)), (setting, settings), (out, files(".mcap"))):
        completed_by(action, completer)
    for action in (criteria, config, base):
        completed_by(action, files(".toml"))
    return parser
