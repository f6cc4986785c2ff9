"""Reads the records of an earlier replay in a log: its results, and the chosen topics and tag table."""

import hashlib
import json
from collections.abc import Iterable
from typing import Final

from roadperc_stream.log import Channel, Metadata
from roadperc_stream.model.tag_tables import TABLES
from roadperc_stream.schemas import record
from roadperc_stream.schemas.protobuf import schema_data
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.schemas.topics import METRICS_TOPIC, ON_REQUEST, result_schemas

_SCHEMAS: Final = result_schemas(tuple(ON_REQUEST.values()))
"""The schema of each result, by topic."""


def is_result(channel: Channel) -> bool:
    """Whether an earlier replay wrote this channel."""
    return record.PRODUCER in channel.metadata


def is_result_log(metadata_names: Iterable[str], channels: Iterable[Channel]) -> bool:
    """Whether a replay wrote the log, by its contents."""
    return record.METADATA_RECORD in metadata_names or any(map(is_result, channels))


def is_result_of(channel: Channel, topic: str) -> bool:
    """Whether a replay wrote this channel. Other programs may use the same topic.

    The field numbers of a row follow from its columns: rows of a version with other columns do not count.
    """
    if channel.topic != topic or not is_result(channel) or channel.schema_name != _SCHEMAS.get(topic):
        return False
    return topic != METRICS_TOPIC or channel.schema_data == schema_data(channel.schema_name)


def recorded_topics(metadata: Iterable[Metadata], channels: Iterable[Channel]) -> dict[str, str]:
    """Topics by role that the user of an earlier replay named, if the log has them."""
    found, prefix = replay_record(metadata), record.TOPIC_KEY
    named = {key.removeprefix(prefix): topic for key, topic in found.items() if key.startswith(prefix)}
    there = {channel.topic for channel in channels if not is_result(channel)}
    return {role: topic for role, topic in named.items() if role in ROLES and topic in there}


def recorded_tag_table(metadata: Iterable[Metadata]) -> str:
    """The tag table that the user of an earlier replay named; empty if unknown."""
    name = replay_record(metadata).get(record.TAG_TABLE_KEY, "")
    return name if name in TABLES else ""


def networks_digest(metadata: Iterable[Metadata]) -> str:
    """Digest of the networks that computed channels of a log: of their models, runtimes and settings; empty without."""
    networks = [sorted(item.values) for item in metadata if item.name == record.NETWORKS_RECORD]
    facts = [[pair for pair in own if pair[0] != record.VERSION_KEY] for own in networks]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest() if facts else ""


def replay_record(metadata: Iterable[Metadata]) -> dict[str, str]:
    """The replay record of a result; empty for other logs."""
    return next((dict(item.values) for item in metadata if item.name == record.METADATA_RECORD), {})
