"""Prints the facts of logs as text or JSON, and repairs logs."""

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import LogError
from roadperc_stream.info.examine import examine
from roadperc_stream.info.facts import LogFacts
from roadperc_stream.info.printing import print_log, print_roles
from roadperc_stream.info.role_states import roles_of
from roadperc_stream.input.outcome import FileSpan, joins
from roadperc_stream.input.source import warnings_of
from roadperc_stream.log import Channel
from roadperc_stream.output.terminal import console_for, print_lines, print_table
from roadperc_stream.output.text_table import Table
from roadperc_stream.schemas.record import log_id_of
from roadperc_stream.schemas.roles import parse_topic_options
from roadperc_stream.system.files import require_free
from roadperc_stream.system.text import listed, number
from roadperc_stream.system.time import ns_to_seconds


def _print_joined(console: Console, logs: Sequence[LogFacts], overrides: Mapping[str, str]) -> None:
    """Print how several logs follow each other in time, and the facts of them as one log.

    Logs without messages are left out.
    """
    spans = sorted(_spans(logs), key=lambda span: (span.first_ns, span.last_ns))
    if not spans:
        return
    began_ns = spans[0].first_ns
    rows = tuple(
        (span.name, *(f"{ns_to_seconds(at_ns - began_ns):.3f}" for at_ns in (span.first_ns, span.last_ns)))
        for span in spans
    )
    print_table(console, Table("As files of one log", ("from s", "to s"), rows))
    lines = (*joins(spans), *_continuations(logs), *_only_in_some(logs), *_whole(logs, spans))
    print_lines(console, "", *lines)
    if not any(facts.provenance for facts in logs):
        print_roles(console, roles_of(_channels(logs), overrides).states)


def _spans(logs: Iterable[LogFacts]) -> Iterator[FileSpan]:
    """The span of each log with messages. In a result only the inputs count, as it may repeat earlier frames."""
    for facts in logs:
        channels = [channel for channel in facts.channels if channel.messages]
        channels = [channel for channel in channels if not channel.result] or channels
        firsts = [channel.first_ns for channel in channels if channel.first_ns is not None]
        lasts = [channel.last_ns for channel in channels if channel.last_ns is not None]
        if firsts and lasts:
            yield FileSpan(Path(facts.log).name, min(firsts), max(lasts), _frames(facts))


def _frames(facts: LogFacts) -> int:
    """Messages of the reference sensor."""
    reference = (state.topic for state in facts.replay.roles if state.role == facts.replay.reference)
    topic = next(reference, None)
    return sum(channel.messages for channel in facts.channels if channel.topic == topic)


def _continuations(logs: Sequence[LogFacts]) -> Iterator[str]:
    """A line for each result that continues another one of the logs."""
    names = {log_id_of(facts.provenance.digest): Path(facts.log).name for facts in logs if facts.provenance}
    for facts in logs:
        before = facts.provenance and names.get(facts.provenance.continues or "")
        if before:
            yield f"{Path(facts.log).name}: continues {before}"


def _channels(logs: Sequence[LogFacts]) -> list[Channel]:
    """The channels with messages, with the fields that assign roles."""
    found = {
        Channel(channel.topic, channel.message_encoding, channel.schema, channel.schema_encoding)
        for facts in logs
        for channel in facts.channels
        if channel.messages
    }
    return sorted(found, key=lambda channel: (channel.topic, channel.schema_name, channel.message_encoding))


def _only_in_some(logs: Sequence[LogFacts]) -> Iterator[str]:
    """A line for each topic that has messages in some of the logs only."""
    holding: dict[str, list[str]] = {}
    for facts in logs:
        for topic in sorted({channel.topic for channel in facts.channels if channel.messages}):
            holding.setdefault(topic, []).append(Path(facts.log).name)
    for topic, names in holding.items():
        if len(names) < len(logs):
            yield f"{topic}: only in {listed(names)}"


def _whole(logs: Sequence[LogFacts], spans: Sequence[FileSpan]) -> Iterator[str]:
    messages, topics = sum(facts.messages for facts in logs), {c.topic for facts in logs for c in facts.channels}
    seconds = ns_to_seconds(max(span.last_ns for span in spans) - spans[0].first_ns)
    yield f"together {number(messages, 'message')} on {number(len(topics), 'topic')} over {seconds:.2f} s"


def recover_log(source: Path, target: Path, *, force: bool) -> None:
    """Repair a log.

    ``force`` replaces an existing target.

    Raises:
        LogError: no message is readable.
        TargetError: ``target`` cannot or must not be written.
    """
    require_free(target, force=force, source=source, suffix=".mcap")
    file = log.received_file(source)
    salvage, recovery = log.write_repaired(file, target)
    console = console_for(sys.stdout)
    if salvage.whole:
        print_lines(console, f"note: {source}: not damaged, nothing was lost", unbroken=True)
    else:
        warnings = warnings_of(source, salvage.damages, recovery, salvage.first_ns)
        print_lines(console, *(f"warning: {warning}" for warning in warnings), unbroken=True)
    print_lines(console, f"wrote {target} ({recovery.saved} messages)", unbroken=True)


def list_logs(paths: Sequence[Path], topics: Sequence[str], cfg: ReplayConfig, *, as_json: bool) -> None:
    """Print the facts of each log; for several logs also how they follow each other.

    The path ``-`` is standard input. ``topics`` are ``ROLE=/NAME``, as a replay takes them; ``cfg`` says what the logs
    do not. ``as_json`` prints a JSON object on one line for each log instead of text.

    Raises:
        ChannelError: a topic option has the wrong form.
        LogError: a log is unreadable or damaged; the others are printed too.
    """
    overrides = parse_topic_options(topics)
    examined: list[LogFacts | LogError] = []
    for path in paths:
        found: Sequence[LogFacts | LogError]
        try:
            found = [examine(file, overrides, cfg) for file in log.received([path])]
        except LogError as error:
            found = [error]
        for item in found:
            if as_json:
                facts = {"log": str(path), "error": str(item)} if isinstance(item, LogError) else asdict(item)
                print_json(facts)
            elif isinstance(item, LogFacts):  # the error at the end reports unreadable files
                console = console_for(sys.stdout)
                print_log(console, item, path)
                print_lines(console, "")
        examined += found
    logs = [facts for facts in examined if isinstance(facts, LogFacts)]
    if len(logs) > 1 and not as_json:
        _print_joined(console_for(sys.stdout), logs, overrides)
    if faults := list(filter(None, map(_fault, examined))):
        raise LogError(listed(faults, len(faults)))


def print_json(facts: Mapping[str, Any]) -> None:
    """Print facts on one line; JSON has no NaN and no infinity, so they become null."""
    finite = json.loads(json.dumps(facts), parse_constant=lambda _: None)
    print(json.dumps(finite, allow_nan=False))


def _fault(found: LogFacts | LogError) -> str:
    """A short description of a file's damage; empty for a good file."""
    if isinstance(found, LogError):
        return str(found)
    if found.file.whole:
        return ""
    damage = found.file.damages[0]
    return f"{found.log}: byte {damage.byte}: {damage.words}"
