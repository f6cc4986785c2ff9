"""Reads a run's lanes, their camera and the times of the frames, from its log and the table beside it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.errors import LogError, TableError
from roadperc_stream.geometry import Camera, Float
from roadperc_stream.input.decoding import Context, Stamped, decode
from roadperc_stream.log import LogSummary
from roadperc_stream.metrics.lanes import columns_at, in_view
from roadperc_stream.model import Lanes
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.record import IMAGES_RECORD
from roadperc_stream.schemas.roles import Kind
from roadperc_stream.schemas.topics import CALIBRATION_SCHEMA, LANES_TOPIC, RESULTS
from roadperc_stream.system.text import whole_number

from ..runs import collect, open_run
from ..scan import rows_of
from .lane_files import DECIMALS, LaneFrame

_SCHEMAS: Final = {"lanes": RESULTS[LANES_TOPIC], "calibration": CALIBRATION_SCHEMA}


@dataclass(frozen=True)
class RunFrame:
    """The lines of a frame: each (N, 2) x, y in px of the camera's image, near end first."""

    stamp_ns: int
    lines_px: tuple[Float, ...]
    run_time_ms: float = 0.0


@dataclass(frozen=True)
class RunLanes:
    """A log with lanes, and their camera; ``has_lanes`` is whether it has a message with lanes."""

    summary: LogSummary
    camera: Camera
    has_lanes: bool

    @property
    def images_ns(self) -> dict[str, int]:
        """The stamp of each labelled image by its name in the converted dataset; empty for other logs."""
        record = next((found.values for found in self.summary.metadata if found.name == IMAGES_RECORD), ())
        return {name: found for name, stamp in record if (found := whole_number(stamp)) is not None}

    def frames(self) -> Iterator[RunFrame]:
        """Every frame in order, with the times of the table beside the log; one without a message has no lines.

        Without a table these are the frames with a message.

        Raises:
            LogError: the log cannot be read.
            DecodeError: a message is not a roadperc.Lanes.
            TableError: the table cannot be read, or lacks a frame of the log.
        """
        table, messages = sidecar_path(self.summary.path, "metrics"), self._with_lanes()
        if not table.exists():
            yield from messages
            return
        rows = rows_of(open_run(table, table.name)).select("stamp_ns", "total_ms")
        following = next(messages, None)
        for stamp_ns, took_ms in collect(rows, str(table)).iter_rows():
            if following is not None and following.stamp_ns == stamp_ns:
                yield replace(following, run_time_ms=took_ms)
                following = next(messages, None)
            else:
                yield RunFrame(stamp_ns, (), took_ms)
        if following is not None:
            raise TableError(f"{table}: no frame with stamp {following.stamp_ns}; it is not the table of the log")

    def _with_lanes(self) -> Iterator[RunFrame]:
        for message in log.read(self.summary, topics=[LANES_TOPIC]):
            content = _decoded("lanes", message)
            boundaries = content.payload.boundaries if isinstance(content.payload, Lanes) else ()
            yield RunFrame(content.stamp_ns, tuple(b.line_px for b in boundaries if len(b.line_px)))


def open_lanes(path: Path) -> RunLanes:
    """Open a run's lanes and their camera.

    Raises:
        LogError: the log cannot be read, or has no lanes or no calibration of their camera.
    """
    summary = log.summarise(path)
    if not any(c.topic == LANES_TOPIC and c.schema_name == _SCHEMAS["lanes"] for c in summary.channels):
        hint = "pass an OUT.mcap of roadperc-replay with lanes"
        raise LogError(f"{path}: no {LANES_TOPIC} of schema {_SCHEMAS['lanes']}; {hint}")
    frame_id = next((pb.Lanes.FromString(m.data).frame_id for m in log.read(summary, topics=[LANES_TOPIC])), None)
    return RunLanes(summary, _camera(summary, frame_id), frame_id is not None)


def _camera(summary: LogSummary, frame_id: str | None) -> Camera:
    """The first calibration of the camera ``frame_id``; of any camera for None."""
    topics = [channel.topic for channel in summary.channels if channel.schema_name == _SCHEMAS["calibration"]]
    for message in log.read(summary, topics=topics) if topics else ():
        camera = _decoded("calibration", message).payload
        if isinstance(camera, Camera) and frame_id in (None, camera.frame_id):
            return camera
    of_camera = f" of camera {frame_id!r} of {LANES_TOPIC}" if frame_id else ""
    raise LogError(f"{summary.path}: no calibration{of_camera}; expected one on any topic")


def _decoded(role: Kind, message: log.Message) -> Stamped:
    kind = message.channel.schema_name, message.channel.message_encoding
    return decode(role, *kind, message.data, message.log_time_ns, Context())


def lane_frame(frame: RunFrame, camera: Camera, size: tuple[int, int], raw_file: str, rows: Float) -> LaneFrame:
    """A run's lines as columns at rows; lines that cross no row are left out.

    Args:
        frame: lines in px of the camera's image.
        camera: the camera of the lines.
        size: columns and rows of the result's image; the camera's image is scaled to it.
        raw_file: name of the frame.
        rows: (N,) px of the scaled image.
    """
    scaled = replace(camera, width=size[0], height=size[1])
    factors = np.divide(size, (camera.width, camera.height))
    lines = (in_view((line + 0.5) * factors - 0.5, scaled) for line in frame.lines_px)
    # rounded as in a file, so that scores do not depend on writing
    lanes = (np.round(columns_at(line, rows, scaled), DECIMALS) for line in lines if len(line))
    return LaneFrame(raw_file, rows, tuple(lane for lane in lanes if np.isfinite(lane).any()), frame.run_time_ms)
