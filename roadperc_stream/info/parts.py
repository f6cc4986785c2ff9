"""Prints how several logs join, as the parts of one: their spans, gaps, overlaps, and what only some have."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from rich.console import Console

from roadperc_stream.core.time import ns_to_seconds
from roadperc_stream.info.facts import LogFacts
from roadperc_stream.info.text import listed, number
from roadperc_stream.input.parts import PartSpan, joins
from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import TextTable, row


def print_parts(console: Console, logs: Sequence[LogFacts]) -> None:
    """How logs join in the order of their times, and what they are as one log.

    Args:
        console: to print on.
        logs: two or more; those without messages have no place among the parts.
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
    print_lines(console, "", *filter(None, joins(spans)), *_only_in_some(logs), *_whole(logs, spans))


def _spans(logs: Iterable[LogFacts]) -> Iterator[PartSpan]:
    for facts in logs:
        if facts.first_ns is not None and facts.last_ns is not None:
            yield PartSpan(Path(facts.log).name, facts.first_ns, facts.last_ns, _frames(facts))


def _frames(facts: LogFacts) -> int:
    """Messages of the reference sensor."""
    reference = (state.topic for state in facts.replay.roles if state.role == facts.replay.reference)
    topic = next(reference, None)
    return sum(channel.messages for channel in facts.channels if channel.topic == topic)


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
