"""A log of any length out of a short one: its frames forwards and backwards in turn, with later stamps."""

import struct
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Final

from roadperc_stream.core.time import NS_PER_S
from roadperc_stream.errors import LogError
from roadperc_stream.log import LogWriter, Message, summarise
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES, set_stamp

_CDR_STAMP: Final = struct.Struct("<iI")
_CDR_HEADER_BYTES: Final = 4
"""Of the encapsulation; what the converter writes is little-endian, and begins with a std_msgs/Header."""


def write_long(source: Path, target: Path, frames: int) -> None:
    """Write a log in which the car drives to and fro, so that there is motion between all frames.

    Args:
        source: a log whose messages of one frame have one log time; a topic's only message holds throughout.
        target: the log to write.
        frames: how many it gets.

    Raises:
        LogError: the source has fewer than two frames.
    """
    summary = summarise(source)
    messages = list(summary.source.messages(None, None, None))
    counts = Counter(message.channel.topic for message in messages)
    of_time: dict[int, list[Message]] = {}
    for message in messages:
        if counts[message.channel.topic] > 1:
            of_time.setdefault(message.log_time_ns, []).append(message)
    stamps = list(of_time)
    if len(stamps) < 2:
        raise LogError(f"{source}: expected two frames or more")
    step_ns = (stamps[-1] - stamps[0]) // (len(stamps) - 1)
    with LogWriter(target) as writer:
        for message in messages:
            if counts[message.channel.topic] == 1:
                writer.write(message)
        for index in range(frames):
            for message in of_time[stamps[folded(index, len(stamps))]]:
                writer.write(restamped(message, stamps[0] + index * step_ns, index))
        for record in summary.metadata:
            writer.describe(record)


def folded(index: int, count: int) -> int:
    """0, 1, ..., count - 1, count - 2, ..., 1, 0, 1, ...: the frame that stands in a place."""
    there_and_back = 2 * (count - 1)
    at = index % there_and_back
    return at if at < count else there_and_back - at


def restamped(message: Message, stamp_ns: int, sequence: int) -> Message:
    """A message with another stamp, in its header as well."""
    return replace(
        message,
        log_time_ns=stamp_ns,
        publish_time_ns=stamp_ns,
        sequence=sequence,
        data=_with_stamp(message, stamp_ns),
    )


def _with_stamp(message: Message, stamp_ns: int) -> bytes:
    if message.channel.message_encoding == "cdr":
        data = bytearray(message.data)
        _CDR_STAMP.pack_into(data, _CDR_HEADER_BYTES, *divmod(stamp_ns, NS_PER_S))
        return bytes(data)
    content = MESSAGE_TYPES[message.channel.schema_name].FromString(message.data)
    set_stamp(content, stamp_ns)
    return content.SerializeToString()
