"""Prints how several logs join, as the parts of one: their spans, gaps, overlaps, and what only some have."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Console

from roadperc_stream.core.text import number
from roadperc_stream.core.time import ns_to_seconds
from roadperc_stream.info.facts import LogFacts
from roadperc_stream.info.replay_printing import print_roles
from roadperc_stream.info.role_states import roles_of
from roadperc_stream.info.text import listed
from roadperc_stream.input.parts import PartSpan, joins
from roadperc_stream.input.roles import no_probe
from roadperc_stream.log import Channel
from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import TextTable, row
from roadperc_stream.schemas.record import log_id_of


def print_parts(console: Console, logs: Sequence[LogFacts], overrides: Mapping[str, str]) -> None:
    """How logs join in the order of their times, and what they are as one log.

    Args:
        console: to print on.
        logs: two or more; those without messages have no place among the parts.
        overrides: topic by role, from ``--topic``.
    """
    spans = sorted(_spans(logs), key=lambda span: (span.first_ns, span.last_ns))
    if not spans:
        return
    began_ns = spans[0].first_ns
    rows = tuple(
        row(span.name, *(f"{ns_to_seconds(at_ns - began_ns):.3f}" for at_ns in (span.first_ns, span.last_ns)))
        for span in spans
    )
    print_table(console, TextTable("As the parts of one log", ("from s", "to s"), rows))
    lines = (*filter(None, joins(spans)), *_continuations(logs), *_only_in_some(logs), *_whole(logs, spans))
    print_lines(console, "", *lines)
    if not any(facts.provenance for facts in logs):
        print_roles(console, roles_of(_channels(logs), overrides, no_probe).states)


def _spans(logs: Iterable[LogFacts]) -> Iterator[PartSpan]:
    """Of results that hold their inputs those count: frames that one gives again are of another one's time."""
    for facts in logs:
        channels = [channel for channel in facts.channels if channel.messages]
        channels = [channel for channel in channels if not channel.result] or channels
        firsts = [channel.first_ns for channel in channels if channel.first_ns is not None]
        lasts = [channel.last_ns for channel in channels if channel.last_ns is not None]
        if firsts and lasts:
            yield PartSpan(Path(facts.log).name, min(firsts), max(lasts), _frames(facts))


def _frames(facts: LogFacts) -> int:
    """Messages of the reference sensor."""
    reference = (state.topic for state in facts.replay.roles if state.role == facts.replay.reference)
    topic = next(reference, None)
    return sum(channel.messages for channel in facts.channels if channel.topic == topic)


def _continuations(logs: Sequence[LogFacts]) -> Iterator[str]:
    """A line for each result that goes on from another one of the logs."""
    names = {log_id_of(facts.provenance.digest): Path(facts.log).name for facts in logs if facts.provenance}
    for facts in logs:
        before = facts.provenance and names.get(facts.provenance.continues or "")
        if before:
            yield f"{Path(facts.log).name}: goes on from {before}"


def _channels(logs: Sequence[LogFacts]) -> list[Channel]:
    """The channels with messages, as far as roles ask for them."""
    found = {
        Channel(channel.topic, channel.message_encoding, channel.schema, channel.schema_encoding)
        for facts in logs
        for channel in facts.channels
        if channel.messages
    }
    return sorted(found, key=lambda channel: (channel.topic, channel.schema_name, channel.message_encoding))


def _only_in_some(logs: Sequence[LogFacts]) -> Iterator[str]:
    """A line for each topic with messages in some of the logs, and none in the others."""
    holding: dict[str, list[str]] = {}
    for facts in logs:
        for topic in sorted({channel.topic for channel in facts.channels if channel.messages}):
            holding.setdefault(topic, []).append(Path(facts.log).name)
    for topic, names in holding.items():
        if len(names) < len(logs):
            yield f"{topic}: only in {listed(names)}"


def _whole(logs: Sequence[LogFacts], spans: Sequence[PartSpan]) -> Iterator[str]:
    messages, topics = sum(facts.messages for facts in logs), {c.topic for facts in logs for c in facts.channels}
    seconds = ns_to_seconds(max(span.last_ns for span in spans) - spans[0].first_ns)
    yield f"together {number(messages, 'message')} on {number(len(topics), 'topic')} over {seconds:.2f} s"
