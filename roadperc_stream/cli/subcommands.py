"""``roadperc`` without a subcommand: help, version, completion, and errors of the first argument."""

import argparse
from collections.abc import Sequence
from typing import Final

from roadperc_stream.cli.launch import COMMANDS
from roadperc_stream.cli.options import add, command_parser, parse

_LIST: Final = "\n".join(f"  {name:<12}{text}" for name, text in COMMANDS.items())
_EPILOG: Final = f"commands:\n{_LIST}\n\n`roadperc COMMAND --help` shows the options of a command."


def main(argv: Sequence[str] | None = None) -> int:
    """Print the help or the version; any other argument is wrong usage, exit code 2."""
    description = "Replay camera logs through a perception chain; evaluate and view the results."
    parser = command_parser("", description, _EPILOG, "roadperc [-h] [--version] COMMAND ...")
    text = "one of the commands below"
    add(parser, "command", metavar="COMMAND", nargs=argparse.REMAINDER, help=text, completer=lambda **_: COMMANDS)
    name = next(iter(parse(parser, argv).command), "")
    problem = f"no command {name!r}" if name else "expected a command"
    parser.error(f"{problem}; commands: {', '.join(COMMANDS)}")
