"""``roadperc`` without a subcommand: help, version, completion, and errors of the first argument."""

import sys
from collections.abc import Sequence
from typing import Final

from roadperc_stream.cli.completers import completed_by
from roadperc_stream.cli.launch import COMMANDS
from roadperc_stream.cli.plumbing import command_parser, parse
from roadperc_stream.system.text import nearest

_LIST: Final = "\n".join(f"  {name:<12}{text}" for name, text in COMMANDS.items())
_EPILOG: Final = f"commands:\n{_LIST}\n\n`roadperc COMMAND --help` shows the options of a command."


def main(argv: Sequence[str] | None = None) -> int:
    """Print the help or the version; any other argument is wrong usage, exit code 2."""
    description = "Replay camera logs through a perception chain; evaluate and view the results."
    parser = command_parser("", description, _EPILOG, "roadperc [-h] [--version] COMMAND ...")
    action = parser.add_argument("command", metavar="COMMAND", help="one of the commands below")
    completed_by(action, lambda **_: COMMANDS)
    given = list(sys.argv[1:] if argv is None else argv)
    name = given[0] if given and not given[0].startswith("-") else parse(parser, given).command
    near = nearest(name, COMMANDS)
    parser.error(f"no command {name!r}; " + (f"did you mean {near}?" if near else f"commands: {', '.join(COMMANDS)}"))
