"""Decodes the messages of a log for their roles, and counts those that cannot be read."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.input.decoding import Context, Stamped, context_of_channel, decode
from roadperc_stream.input.transforms import NOTHING_LATCHED, TransformTree
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.model import Transform
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES, Role

_DEFAULTS: Final = ReplayConfig()
_MOST_EDGES_NAMED: Final = 3
"""Transforms that a problem text lists."""


@dataclass
class Problems:
    """Unreadable messages: the number of each topic, and a text about the first one.

    Args:
        strict_in: the log whose first unreadable message is an error; None to skip unreadable messages.
    """

    strict_in: Path | None = None
    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, topic: str, time_ns: int, error: DecodeError) -> None:
        """Count one more message; ``time_ns`` is its log time or the stamp of its frame.

        Raises:
            LogError: the replay is strict.
        """
        self.require_lenient(f"{topic}: message at {time_ns} ns: {error}")
        self.counts[topic] += 1
        self.first.setdefault(topic, f"{topic}: message at {time_ns} ns: {error}")

    def report(self, topic: str, text: str) -> None:
        """Keep the first text about messages of a topic that are readable, but not fully used.

        Raises:
            LogError: the replay is strict.
        """
        self.require_lenient(text)
        self.first.setdefault(f"{topic}, in part", text)

    def require_lenient(self, text: str) -> None:
        """Raise an error if the replay is strict.

        Raises:
            LogError: the replay is strict.
        """
        if self.strict_in is not None:
            raise LogError(f"{self.strict_in}: {text}; --strict stops there")


@dataclass(frozen=True)
class RoleAssignment:
    """The roles that a log has channels for, each with its topic."""

    topics: Mapping[str, str]
    notes: tuple[str, ...] = ()
    """Notes for the user on guessed and unassigned roles."""
    unassigned: tuple[str, ...] = ()
    """The notes on unassigned roles that have candidate topics."""
    guessed: frozenset[str] = frozenset()
    """Roles whose topic was chosen because it is the only one that fits."""
    chosen: Mapping[str, str] = field(default_factory=dict)
    """Topics that the user named, in this replay or in the one that wrote the log."""
    tag_table: str = ""
    """Recorded table for channels that name none, from the replay that wrote the log; empty without one."""

    @property
    def reference(self) -> str | None:
        """The role whose messages make the frames; None without a topic for one."""
        return next((role for role in REFERENCE_ROLES if role in self.topics), None)

    def roles_of(self, topic: str) -> list[Role]:
        """Roles that a topic is assigned to."""
        return [ROLES[name] for name, known in self.topics.items() if known == topic]


def decoded_messages(
    messages: Iterable[Message],
    roles: RoleAssignment,
    cfg: ReplayConfig = _DEFAULTS,
    problems: Problems | None = None,
    tree: TransformTree = NOTHING_LATCHED.tree,
) -> Iterator[Stamped]:
    """Decode the messages of assigned roles; unreadable ones are counted in ``problems`` and left out.

    ``messages`` are in log-time order. ``cfg`` gives the limits and the tag table: ``auto`` for the channel's table,
    else the recorded one. ``tree`` has the transforms before the first message. Transforms that close a loop in it are
    left out and reported.
    """
    contexts: dict[Channel, Context] = {}
    problems = Problems() if problems is None else problems
    roles_by_topic = {topic: roles.roles_of(topic) for topic in set(roles.topics.values())}
    for message in messages:
        channel = message.channel
        if channel.topic not in roles_by_topic:
            continue
        if channel not in contexts:
            contexts[channel] = context_of_channel(channel, cfg.tag_table, roles.tag_table, cfg.limits)
        for role in roles_by_topic[channel.topic]:
            try:
                content = message.data, message.log_time_ns, contexts[channel]
                decoded = decode(role.kind, channel.schema_name, channel.message_encoding, *content)
            except DecodeError as error:
                problems.add(channel.topic, message.log_time_ns, error)
                continue
            item = replace(decoded, role=role.name, log_time_ns=message.log_time_ns)
            if edges := item.edges:
                kept = _placed(edges, tree, cfg.limits.transforms, problems, (channel.topic, message.log_time_ns))
                if not kept:
                    continue
                tree, item = tree.updated(kept), item if len(kept) == len(edges) else replace(item, payload=kept)
            yield item


def _placed(
    edges: tuple[Transform, ...], tree: TransformTree, most: int, problems: Problems, place: tuple[str, int]
) -> tuple[Transform, ...]:
    """Leave out and report transforms that close a loop, or give the tree more than ``most`` frames.

    ``place`` is the message's topic and log time.
    """
    topic, time_ns = place
    fitting = tree.fitting(edges, most)
    if beyond := len({edge.child for edge in edges} - {edge.child for edge in fitting}):
        text = f"{beyond} transforms to more frames than {most}: left out"
        problems.report(topic, f"{topic}: message at {time_ns} ns: {text}")
    if looping := tree.looping(fitting):
        names = [f"{edge.parent!r} to {edge.child!r}" for edge in fitting if edge.child in looping]
        some = ", ".join(names[:_MOST_EDGES_NAMED]) + ", ..." * (len(names) > _MOST_EDGES_NAMED)
        text = f"a loop of transforms ({some}), expected a tree: left out"
        problems.report(topic, f"{topic}: message at {time_ns} ns: {text}")
    return tuple(edge for edge in fitting if edge.child not in looping)
