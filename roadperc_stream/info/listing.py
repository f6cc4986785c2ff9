"""The facts of several logs on stdout, as text or JSON."""

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.info.examine import examine
from roadperc_stream.info.facts import LogFacts
from roadperc_stream.info.parts import print_parts
from roadperc_stream.info.printing import print_log
from roadperc_stream.info.text import listed
from roadperc_stream.output.terminal import console_for, print_lines
from roadperc_stream.schemas.roles import parse_topic_options


def list_logs(paths: Sequence[Path], topics: Sequence[str], *, as_json: bool) -> None:
    """Print what is known of each log, and of several how they join as the parts of one.

    Args:
        paths: the logs; ``-`` is standard input.
        topics: ``ROLE=/NAME``, as a replay takes them.
        as_json: an object and line per log instead of text.

    Raises:
        ChannelError: a topic option is of another form.
        LogError: one of the logs is not whole; the others are printed all the same.
    """
    overrides = parse_topic_options(topics)
    show = _show_json if as_json else _show_text
    faults, parts = [], list[LogFacts]()
    for path in paths:
        found: LogFacts | LogError
        try:
            (file,) = log.received([path])
            found = examine(file, overrides)
        except LogError as error:
            found = error
        show(path, found)
        parts += [found] if isinstance(found, LogFacts) else []
        fault = _fault(found)
        faults += [fault] if fault else []
    if len(parts) > 1 and not as_json:
        print_parts(console_for(sys.stdout), parts, overrides)
    if faults:
        raise LogError(listed(faults, len(faults)))


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
    """The facts; what cannot be opened is said once, by the error at the end."""
    if isinstance(found, LogFacts):
        console = console_for(sys.stdout)
        print_log(console, found)
        print_lines(console, "")
