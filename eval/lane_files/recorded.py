"""A run's lanes in the image, frame by frame, from its log."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.core.datatypes import Lanes
from roadperc_stream.core.geometry import Camera, Float
from roadperc_stream.errors import LogError
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.log import LogSummary
from roadperc_stream.metrics.lanes import ROW_STEP_PX, columns_at, in_view
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.names import CALIBRATION_SCHEMA
from roadperc_stream.schemas.topics import LANES_TOPIC, RESULTS

from ..collecting import collect
from ..runs import open_run
from ..scan import rows_of
from ..segments import SEGMENT, segment
from .tusimple import LaneFrame, rounded

_SCHEMAS: Final = {"lanes": RESULTS[LANES_TOPIC], "calibration": CALIBRATION_SCHEMA}
_TOP: Final = 160 / 720
"""Where TuSimple's rows begin, as a part of the image's height."""


@dataclass(frozen=True)
class RunFrame:
    """The lines a run saw in a frame: each (N, 2) x, y in px of the camera's image, near end first."""

    stamp_ns: int
    lines_px: tuple[Float, ...]
    run_time_ms: float


@dataclass(frozen=True)
class RunLanes:
    """A log whose lanes can be read, and their camera."""

    summary: LogSummary
    camera: Camera
    times_ms: Sequence[tuple[int, float]]
    """Stamp and whole time of each frame, in order; empty where no metrics table lies next to the log."""

    def frames(self) -> Iterator[RunFrame]:
        """Every frame in order; one that the table knows and the log has no lanes of has no lines.

        Raises:
            LogError: the log cannot be read.
            DecodeError: a message is not a roadperc.Lanes.
        """
        waiting = deque(self.times_ms)
        left = Counter(stamp_ns for stamp_ns, _ in waiting)
        for message in log.read(self.summary, topics=[LANES_TOPIC]):
            stamp_ns, lines_px = _lines(message)
            for before_ns, took_ms in _before(waiting, stamp_ns, left):
                yield RunFrame(before_ns, (), took_ms)
            _, took_ms = waiting.popleft() if left[stamp_ns] > 0 else (stamp_ns, 0.0)
            left[stamp_ns] -= 1
            yield RunFrame(stamp_ns, lines_px, took_ms)
        yield from (RunFrame(stamp_ns, (), took_ms) for stamp_ns, took_ms in waiting)


def open_lanes(path: Path) -> RunLanes:
    """Find a run's lanes, their camera, and the metrics table next to the log.

    Raises:
        LogError: the log cannot be read, or has no lanes or no calibration of their camera.
        TableError: the table next to it cannot be read.
    """
    summary = log.summarise(path)
    channels = summary.channels
    if not any(c.topic == LANES_TOPIC and c.schema_name == _SCHEMAS["lanes"] for c in channels):
        raise LogError(
            f"{path}: no {LANES_TOPIC} of {_SCHEMAS['lanes']}; expected an OUT.mcap of roadperc-replay with lanes"
        )
    frame_id = next((pb.Lanes.FromString(m.data).frame_id for m in log.read(summary, topics=[LANES_TOPIC])), None)
    topics = [c.topic for c in channels if c.schema_name == _SCHEMAS["calibration"]]
    return RunLanes(summary, _camera(summary, topics, frame_id), _times_ms(path))


def _before(waiting: deque[tuple[int, float]], stamp_ns: int, left: Counter[int]) -> Iterator[tuple[int, float]]:
    """Take out the frames before the next of a stamp, which may lie in a later segment, or those of earlier stamps."""
    while waiting and (waiting[0][0] != stamp_ns if left[stamp_ns] > 0 else waiting[0][0] < stamp_ns):
        left[waiting[0][0]] -= 1
        yield waiting.popleft()


def default_rows(height: int) -> Float:
    """TuSimple's rows: the multiples of 10 px from 160 to 710 of 720, and the same part of another height."""
    return np.arange(np.ceil(height * _TOP / ROW_STEP_PX) * ROW_STEP_PX, height, ROW_STEP_PX)


def lane_frame(frame: RunFrame, camera: Camera, size: tuple[int, int], raw_file: str, rows: Float) -> LaneFrame:
    """A run's lines as columns at rows; a line that crosses none of them is left out.

    Args:
        frame: lines in px of the camera's image.
        camera: their camera.
        size: columns and rows of the image in whose px the result is; the camera's image scaled to it.
        raw_file: name of the frame.
        rows: (N,) px of the scaled image.
    """
    shown = replace(camera, width=size[0], height=size[1])
    factors = np.divide(size, (camera.width, camera.height))
    lines = (in_view((line + 0.5) * factors - 0.5, shown) for line in frame.lines_px)
    lanes = (rounded(columns_at(line, rows, shown)) for line in lines if len(line))
    return LaneFrame(raw_file, rows, tuple(lane for lane in lanes if np.isfinite(lane).any()), frame.run_time_ms)


def _lines(message: log.Message) -> tuple[int, tuple[Float, ...]]:
    """Stamp of a message, and its boundaries' lines in the image."""
    channel = message.channel
    content = decode(
        "lanes", channel.schema_name, channel.message_encoding, message.data, message.log_time_ns, Context()
    )
    boundaries = content.payload.boundaries if isinstance(content.payload, Lanes) else ()
    return content.stamp_ns, tuple(b.line_px for b in boundaries if len(b.line_px))


def _camera(summary: LogSummary, topics: list[str], frame_id: str | None) -> Camera:
    for message in log.read(summary, topics=topics) if topics else ():
        channel = message.channel
        content = decode(
            "calibration", channel.schema_name, channel.message_encoding, message.data, message.log_time_ns, Context()
        )
        if isinstance(content.payload, Camera) and content.payload.frame_id == frame_id:
            return content.payload
    raise LogError(
        f"{summary.path}: no calibration of {frame_id!r}, the camera of {LANES_TOPIC}; expected one on any topic"
    )


def _times_ms(path: Path) -> list[tuple[int, float]]:
    table = sidecar_path(path, "metrics")
    if not table.exists():
        return []
    run = open_run(table, path.stem)
    rows = rows_of(run).select(segment(run.columns), "stamp_ns", "total_ms").sort(SEGMENT, "stamp_ns")
    return list(collect(rows.drop(SEGMENT), str(table)).iter_rows())
