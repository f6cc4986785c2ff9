"""Copies a log without some seconds of its segmentation, as if the network had stopped.

A log of ten minutes, with a fault of two seconds:

    .venv/bin/roadperc-render drive --size 160x120 --rate 10 --seconds 600 --scene straight --without right
    .venv/bin/roadperc-convert drive drive.mcap
    .venv/bin/python -m tests.faulty_log drive.mcap faulty.mcap 401.3 2
"""

import sys
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.system.time import seconds_to_ns


def with_fault(source, target, start_s, length_s):
    """Copy a log; ``start_s`` counts from its first message."""
    summary = log.summarise(source)
    start_ns = summary.first_ns + seconds_to_ns(start_s)
    fault = range(start_ns, start_ns + seconds_to_ns(length_s))
    with log.LogWriter(target) as writer:
        for message in log.read(summary):
            if message.channel.topic != ROLES["segmentation"].topic or message.log_time_ns not in fault:
                writer.write(message)
    return target


if __name__ == "__main__":
    with_fault(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
