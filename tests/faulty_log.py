"""Copies a log several times in a row, and without some seconds of its segmentation, as if the network had stopped.

A log of ten minutes, with a fault of two seconds:

    roadperc-render drive --size 160x120 --rate 10 --seconds 4 --scene straight --without right
    roadperc-convert drive drive.mcap
    python -m tests.faulty_log drive.mcap faulty.mcap 150 401.3 2
"""

import struct
import sys
from dataclasses import replace
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES, set_stamp, stamp_ns
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.time import NS_PER_S, seconds_to_ns

ONCE = {ROLES[role].topic for role in ("calibration", "tf")}
_CDR_STAMP = struct.Struct("<iI")
_CDR_STAMP_AT = 4


def with_fault(source, target, times, start_s, length_s):
    """Copy a log of equally spaced frames; the fault's start counts from the first message."""
    messages = list(log.read(log.summarise(source)))
    first_ns = messages[0].log_time_ns
    stamps = sorted({message.log_time_ns for message in messages})
    period_ns = stamps[-1] - first_ns + stamps[1] - first_ns
    start_ns = first_ns + seconds_to_ns(start_s)
    fault = range(start_ns, start_ns + seconds_to_ns(length_s))
    with log.LogWriter(target) as writer:
        for number in range(times):
            for message in (later(message, number * period_ns) for message in messages):
                lost = message.channel.topic == ROLES["segmentation"].topic and message.log_time_ns in fault
                if not lost and not (number and message.channel.topic in ONCE):
                    writer.write(message)
    return target


def later(message, by_ns):
    """A message with all its times later."""
    if message.channel.message_encoding == "cdr":
        data, (seconds, nanos) = bytearray(message.data), _CDR_STAMP.unpack_from(message.data, _CDR_STAMP_AT)
        _CDR_STAMP.pack_into(data, _CDR_STAMP_AT, *divmod(seconds * NS_PER_S + nanos + by_ns, NS_PER_S))
    elif message.channel.topic in ONCE:
        data = message.data
    else:
        content = MESSAGE_TYPES[message.channel.schema_name].FromString(message.data)
        set_stamp(content, stamp_ns(content.timestamp) + by_ns)
        data = content.SerializeToString(deterministic=True)
    times_ns = {"log_time_ns": message.log_time_ns + by_ns, "publish_time_ns": message.publish_time_ns + by_ns}
    return replace(message, data=bytes(data), **times_ns)


if __name__ == "__main__":
    with_fault(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), float(sys.argv[5]))
