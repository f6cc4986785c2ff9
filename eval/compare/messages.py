"""Comparison of two logs with results, message by message: frames pair by log time, messages by topic and order."""

import hashlib
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from google.protobuf.message import DecodeError as ProtobufError
from google.protobuf.message import Message as ProtobufMessage

from roadperc_stream import log
from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.formats import images
from roadperc_stream.input.decoding.ros import unpack_image
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.log import Message
from roadperc_stream.schemas import ros2
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES
from roadperc_stream.schemas.topics import IMAGE_SCHEMA, METRICS_TOPIC, RESULT_PREFIX

from ..options import Rules
from .fields import Agreement, Difference, Value, added, distance

_MESSAGE: Final = "message"
"""Field name of a message that only one log has."""
_INDEX: Final = re.compile(r"\[\d+\]")
Fields = Mapping[str, Value]
"""Values by their place in a message, such as ``boundaries[0].offset_m``."""
Group = dict[tuple[str, int], Message]
"""Messages of one log time by topic and order on it."""


def message_agreements(base: Path, new: Path, run: str, rules: Rules) -> dict[str, Agreement]:
    """Agreement of each field of the results, by its topic below /perception and its name without indices.

    Only the messages of two frames are in memory.

    Raises:
        LogError: a log cannot be read, or a result in it cannot be decoded.
    """
    frames = aligned(_results(base), _results(new))
    both = ((ours, theirs) for ours, theirs in frames if ours and theirs)  # the tables report the others
    return added(frame_agreements(ours, theirs, (base, new), run, rules) for ours, theirs in both)


def _results(path: Path) -> Iterator[Message]:
    """The results in a log, without the metrics, which are in the table."""
    summary = log.summarise(path)
    topics = {channel.topic for channel in summary.channels if is_result(channel)} - {METRICS_TOPIC}
    return (message for message in log.read(summary, topics=topics) if is_result(message.channel))


def aligned(ours: Iterator[Message], theirs: Iterator[Message]) -> Iterator[tuple[Group, Group]]:
    """The messages of each log time on both sides, in the order of time; empty if a side has none of that time."""
    lefts, rights = _groups(ours), _groups(theirs)
    left, right = next(lefts, None), next(rights, None)
    while left is not None or right is not None:
        time_ns = min(side[0] for side in (left, right) if side is not None)
        here = [side[1] if side is not None and side[0] == time_ns else {} for side in (left, right)]
        yield here[0], here[1]
        left = next(lefts, None) if here[0] else left
        right = next(rights, None) if here[1] else right


def _groups(messages: Iterator[Message]) -> Iterator[tuple[int, Group]]:
    for log_time_ns, at_once in groupby(messages, lambda message: message.log_time_ns):
        group: Group = {}
        counts: dict[str, int] = defaultdict(int)
        for message in at_once:
            topic = message.channel.topic.removeprefix(RESULT_PREFIX)
            group[topic, counts[topic]] = message
            counts[topic] += 1
        yield log_time_ns, group


def frame_agreements(
    ours: Group, theirs: Group, paths: tuple[Path, Path], run: str, rules: Rules
) -> dict[str, Agreement]:
    """Agreements of the messages of one log time; a field with several values counts once, with its largest."""
    found: dict[str, Agreement] = {}
    for topic, nth in dict.fromkeys((*ours, *theirs)):
        pair = ours.get((topic, nth)), theirs.get((topic, nth))
        for place, values in _values_apart(pair, paths):
            name = f"{topic}.{_INDEX.sub('', place)}"
            if not rules.ignores(name):
                at = next(message for message in pair if message)
                first = Difference(run, at.sequence, at.log_time_ns, f"{topic}.{place}", *values)
                apart = distance(*values)
                if apart <= rules.tolerance(name):
                    one = Agreement(within=int(apart > 0), largest=apart)
                else:
                    one = Agreement(differing=1, largest=apart if np.isfinite(apart) else 0.0, first=first)
                both = found.get(name, Agreement()) + one
                differing = min(both.differing, 1)
                found[name] = replace(both, within=min(both.within, 1 - differing), differing=differing)
    return found


def _values_apart(
    pair: tuple[Message | None, Message | None], paths: tuple[Path, Path]
) -> Iterator[tuple[str, tuple[Value, Value]]]:
    """Both values of each field of two messages with different bytes; or the fact that only one message is present."""
    ours, theirs = pair
    if ours is None or theirs is None:
        yield _MESSAGE, ("present" if ours else None, "present" if theirs else None)
    elif ours.data != theirs.data:
        fields = [_fields(message, path) for message, path in zip((ours, theirs), paths, strict=True)]
        for place in dict.fromkeys((*fields[0], *fields[1])):
            yield place, (fields[0].get(place), fields[1].get(place))


def _fields(message: Message, path: Path) -> Fields:
    try:
        return _decoded(message)
    except (DecodeError, ProtobufError) as error:
        raise LogError(f"{path}: {message.channel.topic} at {message.log_time_ns}: {error}") from error


def _decoded(message: Message) -> Fields:
    schema, data = message.channel.schema_name, message.data
    if schema == ros2.IMAGE:
        image = unpack_image(data)
        return {"stamp_ns": image.stamp_ns, "frame_id": image.frame_id, "pixels": _digest(image.pixels.tobytes())}
    if schema == ros2.OCCUPANCY_GRID:
        stamp_ns, frame_id = ros2.unpack_header(data, schema)
        return {"stamp_ns": stamp_ns, "frame_id": frame_id, "grid": _digest(data)}
    if schema not in MESSAGE_TYPES:
        return {"data": _digest(data)}
    decoded: Any = MESSAGE_TYPES[schema].FromString(data)
    fields = dict(_flat(decoded, ""))
    if schema == IMAGE_SCHEMA:
        pixels = images.decode_bgr if decoded.format == "jpeg" else images.decode_indices
        fields["data"] = _digest(pixels(decoded.data).tobytes())
    return fields


def _flat(message: ProtobufMessage, prefix: str) -> Iterator[tuple[str, Value]]:
    """The fields of a message, depth first; enumeration values by name, lists with their length."""
    for field in message.DESCRIPTOR.fields:
        if field.has_presence and not message.HasField(field.name):
            continue
        value, place = getattr(message, field.name), f"{prefix}{field.name}"
        if field.is_repeated:
            yield f"{place}.length", len(value)
            for index, item in enumerate(value):
                yield from _item(field, item, f"{place}[{index}]")
        else:
            yield from _item(field, value, place)


def _item(field: Any, value: Any, place: str) -> Iterator[tuple[str, Value]]:
    if isinstance(value, ProtobufMessage):
        yield from _flat(value, f"{place}.")
    elif field.enum_type is not None:
        known = field.enum_type.values_by_number.get(value)
        yield place, known.name if known else value
    else:
        yield place, _digest(value) if isinstance(value, bytes) else value


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:12]
