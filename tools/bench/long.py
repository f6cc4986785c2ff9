"""What may not grow with the log: memory over 100 and 3000 frames, and encoding over frames 0 to 100 and 900 to 1000.

Run it with ``make bench-long``. The log is that of the bench with a stereo pair, its frames forwards and backwards in
turn.
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
from .replays import Cost, cost_of, replay_words

_CDR_STAMP: Final = struct.Struct("<iI")
_CDR_HEADER_BYTES: Final = 4
"""Of the encapsulation; what the converter writes is little-endian, and begins with a std_msgs/Header."""


def write_long(source: Path, target: Path, frames: int) -> None:
    """Write a log in which the car drives to and fro, so that there is motion between all frames.

    Args:
        source: a log of two frames or more whose messages of one frame have one log time; a topic's only message holds
            throughout.
        target: the log to write.
        frames: how many it gets.
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
    """0, 1, ..., count - 1, count - 2, ..., 1, 0, 1, ...: the frame at a place."""
    at = index % (2 * (count - 1))
    return at if at < count else 2 * (count - 1) - at


def restamped(message: Message, stamp_ns: int, sequence: int) -> Message:
    """A message with another stamp, in its header as well."""
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
"""Frames of the short log, frames over which encoding is averaged, and where they begin late in the log."""


def long_figures(folder: Path, source: BenchLog, frames: int) -> list[SpeedFigure]:
    """Replay a long log and a short one, made of a short one's frames; the last result is kept in the folder."""
    log, result = folder / "long.mcap", folder / "long-result.mcap"
    costs: list[Cost] = []
    for length in (min(_SHORT, frames), frames):
        words = replay_words(log, result, "--threads", "1", "--force", "--quiet")
        try:
            write_long(source.path, log, length)
            costs.append(cost := cost_of(f"replay of {length} frames", words))
        finally:
            log.unlink(missing_ok=True)
        print_line(f"{length} frames: {cost.peak_mb:.0f} MB, {cost.cpu_s:.0f} s of processors, {cost.wall_s:.0f} s")
    return growth(costs[0], costs[1], read_metrics(result)["encode_ms"].to_list())


def growth(short: Cost, long: Cost, encode_ms: list[float]) -> list[SpeedFigure]:
    """What is wanted of a long log, and what was measured.

    Args:
        short: of the short log.
        long: of the long one.
        encode_ms: of each frame of the long one; compared where there are enough.
    """
    found = [
        SpeedFigure("memory over the long log, of that over the short one", long.peak_mb / short.peak_mb, most=1.05),
        SpeedFigure("peak memory with stereo, MB", long.peak_mb, most=500.0),
    ]
    if len(encode_ms) < _LATE + _WINDOW:
        return found
    early, late = (sum(encode_ms[at : at + _WINDOW]) for at in (0, _LATE))
    return [*found, SpeedFigure("encoding late in the log, of that early in it", late / early, most=1.1)]
