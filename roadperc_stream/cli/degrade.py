"""``roadperc-degrade``: write a log with corruptions of known severity."""

import argparse
import sys
from pathlib import Path
from textwrap import fill
from typing import Final

from roadperc_stream.cli.completers import files, words
from roadperc_stream.cli.launch import run
from roadperc_stream.cli.options import add, add_shared, command_parser, parse
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import require_free
from roadperc_stream.system.process import optional_output
from roadperc_stream.system.text import print_line

_EXAMPLE: Final = """\
example:
  roadperc-degrade in.mcap foggy.mcap --with fog=3,frame_drop=2 --seed 1
  roadperc-replay foggy.mcap out.mcap
  roadperc-sweep in.mcap --degrade fog=1,3,5

corruptions:
{names}
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-degrade``: exit code 0 on success, 1 on an error, 2 on wrong usage."""
    arguments = parse(_parser(), argv)
    return run(lambda: _degrade(arguments))


def _degrade(arguments: argparse.Namespace) -> None:
    from roadperc_stream.output.terminal import frame_progress
    from roadperc_stream.tools.degrade import degrade_log

    source, out, severities = arguments.log, arguments.out, arguments.severities
    require_free(out, force=arguments.force, suffix=".mcap", source=source)
    with frame_progress("degrading", not arguments.quiet) as progress:
        overrides = parse_topic_options(arguments.topic)
        remarks = degrade_log(source, out, severities, arguments.seed, overrides, progress)
    with optional_output(sys.stderr):
        for text in remarks:
            print_line(f"warning: {text}", sys.stderr)
    if not arguments.quiet:
        made = ", ".join(f"{name}={severity}" for name, severity in severities.items())
        print_line(f"{made}, seed {arguments.seed}, {out.stat().st_size / 1e6:.1f} MB: {out}")


def _parser() -> argparse.ArgumentParser:
    from roadperc_stream.tools.corruptions import levels

    parser = command_parser(
        "degrade",
        "Write a log with corruptions. The same seed gives the same bytes. The truth and all other messages stay.",
        _EXAMPLE.format(names=fill(", ".join(levels.LEVELS), 100, initial_indent="  ", subsequent_indent="  ")),
    )
    add(parser, "log", type=Path, metavar="IN.mcap", help="log to read", completer=files(".mcap"))
    add(parser, "out", type=Path, metavar="OUT.mcap", help="log to write", completer=files(".mcap"))
    add(
        parser,
        "--with",
        dest="severities",
        type=levels.severities,
        metavar="NAME=SEVERITY,...",
        required=True,
        help="corruptions, in this order, with severities of 1 to 5; severity 0 changes nothing",
        completer=words(f"{name}=" for name in levels.LEVELS),
    )
    quiet = "print errors and warnings only"
    add_shared(parser, "seed", "topic", force="replace an existing log", quiet=quiet)
    return parser
