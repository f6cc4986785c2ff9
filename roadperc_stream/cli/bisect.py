"""``roadperc-bisect``: find the shortest excerpt of a log for which a criterion still fails."""

import argparse
from pathlib import Path

from roadperc_stream.cli.completers import LOGS, files
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_shared, command_parser, parse

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
    return run(lambda: bisect(options), "bisect")


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        "bisect",
        "Find the shortest excerpt of a log for which a criterion still fails when the excerpt is replayed alone,\n"
        "and the fewest changed settings that it needs. Write the excerpt with its results.",
        _EXAMPLE,
    )
    add(parser, "log", metavar="LOG", type=Path, help="the log to replay", completer=files(*LOGS))
    criteria = "the criteria, as in roadperc-check"
    toml = files(".toml")
    add(parser, "--criteria", metavar="FILE.toml", type=Path, required=True, help=criteria, completer=toml)
    criterion = "the criterion; without this option the first one that fails"
    add(parser, "--criterion", metavar="NAME", help=criterion)
    base = "the settings that work, instead of the default ones"
    add(parser, "--base", metavar="FILE", type=Path, help=base, completer=toml)
    out = "the excerpt (default: LOG.bisect.mcap in this folder)"
    add(parser, "--out", metavar="FILE.mcap", type=Path, help=out, completer=files(".mcap"))
    add_shared(parser, "config", "set", "topic", force="replace an existing excerpt")
    return parser
