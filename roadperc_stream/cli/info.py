"""``roadperc-info``: what is in a log, whether it is whole, and what a replay would make of it."""

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from roadperc_stream import __version__
from roadperc_stream.cli.plumbing import run
from roadperc_stream.cli.terminal import console_for, print_lines
from roadperc_stream.errors import LogError
from roadperc_stream.info.examine import examine
from roadperc_stream.info.facts import LogFacts
from roadperc_stream.info.printing import print_log
from roadperc_stream.info.text import listed
from roadperc_stream.schemas.roles import parse_topic_options

_EXAMPLE = """\
example:
  roadperc-info logs/sample.mcap
  roadperc-info bag.mcap --topic image=/front/rgb      as roadperc-replay would take it
  roadperc-info --json logs/*.mcap                     a JSON object and line per log, for scripts; times in ns

The keys of --json are the fields in roadperc_stream/info/facts.py; a log that cannot be opened gives "log" and "error".
Exit code 0: every log is whole; 1: one is cut, damaged or no log at all (the others are printed all the same).
"""


def main(argv: list[str] | None = None) -> int:
    """``roadperc-info``: print what is known of logs."""
    arguments = _parser().parse_args(argv)
    return run(lambda: _info(arguments.logs, parse_topic_options(arguments.topic), arguments.json))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="roadperc-info",
        description="Print what is in a log and whether the file is whole; which roles its channels fill, and what a\n"
        "replay has to do without; of a result, which configuration made it, and whether it is unchanged.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", metavar="LOG", type=Path, nargs="+", help="a log, input or result, also a damaged one")
    parser.add_argument("--topic", metavar="ROLE=/NAME", action="append", default=[], help="the topic of a role")
    parser.add_argument("--json", action="store_true", help="one JSON object a log, on a line of its own")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    return parser


def _info(paths: Sequence[Path], overrides: Mapping[str, str], as_json: bool) -> None:
    show = _show_json if as_json else _show_text
    faults = []
    for path in paths:
        found: LogFacts | LogError
        try:
            found = examine(path, overrides)
        except LogError as error:
            found = error
        show(path, found)
        fault = _fault(found)
        faults += [fault] if fault else []
    if faults:
        raise LogError(listed(faults, 3))


def _fault(found: LogFacts | LogError) -> str:
    """What is wrong with a file, in a few words; empty where nothing is."""
    if isinstance(found, LogError):
        return str(found)
    if found.file.whole:
        return ""
    damage = found.file.damages[0]
    return f"{found.log}: byte {damage.byte}: {damage.words}"


def _show_json(path: Path, found: LogFacts | LogError) -> None:
    facts = {"log": str(path), "error": str(found)} if isinstance(found, LogError) else asdict(found)
    print(json.dumps(_finite(facts), allow_nan=False))


def _finite(value: Any) -> Any:
    """A tree with null for numbers that are not finite, which JSON cannot say."""
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _show_text(_: Path, found: LogFacts | LogError) -> None:
    console = console_for(sys.stdout)
    if isinstance(found, LogFacts):
        print_log(console, found)
    else:
        print_lines(console, str(found), unbroken=True)
    print_lines(console, "")
