"""Check long logs: memory over 100 and 3000 frames, and encoding time in frames 0 to 100 and 900 to 1000.

Run ``make bench-long``. The log repeats the frames of the benchmark's stereo log forwards and backwards.
"""

import struct
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Final

from roadperc_stream.api import read_metrics
from roadperc_stream.log import LogWriter, Message, summarise
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES, set_stamp
from roadperc_stream.system.text import print_line
from roadperc_stream.system.time import NS_PER_S

from .figures import SpeedFigure
from .inputs import BenchLog
from .replays import Cost, cost_of, replay_command

_CDR_STAMP: Final = struct.Struct("<iI")
_CDR_HEADER_BYTES: Final = 4
"""Size of the encapsulation; the converter writes little-endian messages that start with a std_msgs/Header."""


def write_long(source: Path, target: Path, frames: int) -> None:
    """Write a log in which the car drives forwards and backwards, so that it moves between all frames.

    ``source`` has at least two frames; all messages of a frame have the same log time. A topic with a single message is
    static.
    """
    summary = summarise(source)
    messages = list(summary.source.messages(None, None, None))
    counts = Counter(message.channel.topic for message in messages)
    of_time: dict[int, list[Message]] = {}
    for message in messages:
        if counts[message.channel.topic] > 1:
            of_time.setdefault(message.log_time_ns, []).append(message)
    stamps = list(of_time)
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
    """Return the source frame of an index: 0, 1, ..., count - 1, count - 2, ..., 1, 0, 1, ..."""
    at = index % (2 * (count - 1))
    return at if at < count else 2 * (count - 1) - at


def restamped(message: Message, stamp_ns: int, sequence: int) -> Message:
    """Return a message with another stamp, also in its header."""
    if message.channel.message_encoding == "cdr":
        buffer = bytearray(message.data)
        _CDR_STAMP.pack_into(buffer, _CDR_HEADER_BYTES, *divmod(stamp_ns, NS_PER_S))
        data = bytes(buffer)
    else:
        content = MESSAGE_TYPES[message.channel.schema_name].FromString(message.data)
        set_stamp(content, stamp_ns)
        data = content.SerializeToString()
    return replace(message, log_time_ns=stamp_ns, publish_time_ns=stamp_ns, sequence=sequence, data=data)


_SHORT: Final = 100
_WINDOW: Final = 100
_LATE: Final = 900
"""Frames of the short log, frames per average of the encoding time, and first frame of the late average."""


def long_figures(folder: Path, source: BenchLog, frames: int) -> list[SpeedFigure]:
    """Replay a short and a long log of a source's frames; the folder keeps the last result."""
    log, result = folder / "long.mcap", folder / "long-result.mcap"
    costs: list[Cost] = []
    for length in (min(_SHORT, frames), frames):
        command = replay_command(log, result, "--threads", "1", "--force", "--quiet")
        try:
            write_long(source.path, log, length)
            costs.append(cost := cost_of(f"replay of {length} frames", command))
        finally:
            log.unlink(missing_ok=True)
        print_line(f"{length} frames: {cost.peak_mb:.0f} MB, {cost.cpu_s:.0f} s of CPU time, {cost.wall_s:.0f} s")
    return growth(costs[0], costs[1], read_metrics(result)["encode_ms"].to_list())


def growth(short: Cost, long: Cost, encode_ms: list[float]) -> list[SpeedFigure]:
    """Return the figures of a long log; ``encode_ms`` of its frames is compared if there are enough."""
    found = [
        SpeedFigure("memory, long log over short log", long.peak_mb / short.peak_mb, most=1.05),
        SpeedFigure("peak memory with stereo, MB", long.peak_mb, most=500.0),
    ]
    if len(encode_ms) < _LATE + _WINDOW:
        return found
    early, late = (sum(encode_ms[at : at + _WINDOW]) for at in (0, _LATE))
    return [*found, SpeedFigure("encoding time, late over early", late / early, most=1.1)]
