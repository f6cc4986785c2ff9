"""Reads a run's lanes from its log, and reads and writes TuSimple's JSON lines.

Each line is a JSON object for one frame. A lane is a list of columns in px, one for each of the frame's rows.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from roadperc_stream import log
from roadperc_stream.config.complaints import complaint, key_of
from roadperc_stream.errors import LogError, RoadpercError
from roadperc_stream.geometry import Camera, Float
from roadperc_stream.input.decoding import Context, Stamped, decode
from roadperc_stream.log import LogSummary
from roadperc_stream.metrics.lanes import ROW_STEP_PX, columns_at, in_view
from roadperc_stream.model import Lanes
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.record import IMAGES_RECORD
from roadperc_stream.schemas.roles import Kind
from roadperc_stream.schemas.topics import CALIBRATION_SCHEMA, LANES_TOPIC, RESULTS
from roadperc_stream.system.files import completing, read_file, require_suffix
from roadperc_stream.system.text import whole_number

from .runs import collect, open_run
from .scan import SEGMENT, rows_of

ABSENT_PX: Final = -2
"""The written column of an absent point; any negative column is read as absent."""
FARTHEST_PX: Final = 1e9
"""Largest absolute column or row that is accepted, so that squares stay finite."""
_DECIMALS: Final = 2
_MOST_BYTES: Final = 1_000_000_000
"""Largest file of lanes."""
_SCHEMAS: Final = {"lanes": RESULTS[LANES_TOPIC], "calibration": CALIBRATION_SCHEMA}
_TOP: Final = 160 / 720
"""TuSimple's first row as a ratio of the image's height."""


class LaneFileError(RoadpercError):
    """A file of lanes is not in TuSimple's or CULane's format, or does not belong to the run."""


@dataclass(frozen=True)
class LaneFrame:
    """A frame's lanes: ``rows`` (N,) px; each lane has (N,) columns in px, NaN if absent.

    ``place`` is the frame's FILE:LINE for error messages.
    """

    raw_file: str
    rows: Float
    lanes: tuple[Float, ...]
    run_time_ms: float = 0.0
    place: str = ""


_Pixel = Annotated[int | FiniteFloat, Field(ge=-FARTHEST_PX, le=FARTHEST_PX)]


class _Line(BaseModel):
    """One line of a file, its keys in the order of the benchmark's own description."""

    model_config = ConfigDict(strict=True)

    raw_file: str
    lanes: list[list[_Pixel]]
    h_samples: list[_Pixel] = Field(min_length=1)
    run_time: FiniteFloat = 0.0


def to_line(frame: LaneFrame) -> str:
    """One frame as a line of JSON, columns rounded to hundredths of a pixel."""
    lanes = [_numbers(np.nan_to_num(lane, nan=ABSENT_PX)) for lane in frame.lanes]
    run_time = round(frame.run_time_ms, _DECIMALS)
    # without validation: a small image may have none of TuSimple's rows; only files to read must have one
    rows = _numbers(frame.rows)
    line = _Line.model_construct(raw_file=frame.raw_file, lanes=lanes, h_samples=rows, run_time=run_time)
    return line.model_dump_json() + "\n"


def _numbers(values: Float) -> list[int | float]:
    """Values with whole numbers as integers, as in the benchmark's files."""
    return [int(value) if value.is_integer() else round(value, _DECIMALS) for value in values.tolist()]


def read_frames(path: Path) -> list[LaneFrame]:
    """The frames of a file, one for each line; empty lines are skipped.

    Raises:
        LaneFileError: a line is not a JSON object of the format, or the file is empty.
        OSError: the file cannot be read.
    """
    lines = read_file(path, _MOST_BYTES).split(b"\n")
    frames = [_frame(line, f"{path}:{k}") for k, line in enumerate(lines, 1) if line.strip()]
    if not frames:
        raise LaneFileError(f"{path}: no lines in this file; expected a JSON object for each frame")
    return frames


def _frame(text: bytes, place: str) -> LaneFrame:
    try:
        line = _Line.model_validate_json(text)
    except ValidationError as error:
        found = error.errors(include_url=False)[0]
        why = ": ".join(filter(None, (key_of(found["loc"]), complaint(found))))
        raise LaneFileError(f"{place}: is not in TuSimple's format: {why}") from error
    rows = len(line.h_samples)
    for k, lane in enumerate(line.lanes):
        if len(lane) != rows:
            raise LaneFileError(f"{place}: lanes[{k}] has {len(lane)} columns; expected {rows}, one per h_sample")
    columns = (np.array(lane, float) for lane in line.lanes)
    lanes = tuple(np.where(lane < 0, np.nan, lane) for lane in columns)
    return LaneFrame(line.raw_file, np.array(line.h_samples, float), lanes, line.run_time, place)


def image_name(raw_file: str) -> str:
    """The path of an image from its dataset's folder on."""
    return PurePosixPath(raw_file.lstrip("/")).as_posix()


@contextmanager
def lane_writer(target: Path | None) -> Iterator[Callable[[LaneFrame], object]]:
    """A function that appends frames to a ``.json`` or ``.jsonl`` file, or does nothing without a target.

    The file is a partial file until it is complete.

    Raises:
        TargetError: the file cannot be written, or has another suffix.
    """
    if target is None:
        yield lambda _frame: None
        return
    require_suffix(target, ".json", ".jsonl")
    with completing(target) as temporary, temporary.open("w", encoding="utf-8") as stream:
        yield lambda frame: stream.write(to_line(frame))


@dataclass(frozen=True)
class RunFrame:
    """The lines of a frame: each (N, 2) x, y in px of the camera's image, near end first."""

    stamp_ns: int
    lines_px: tuple[Float, ...]
    run_time_ms: float


@dataclass(frozen=True)
class RunLanes:
    """A log with lanes, and their camera.

    ``times_ms`` are stamp and total time of each frame, in order; empty without a metrics table beside the log.
    ``has_lanes`` is whether the log has a message with lanes.
    """

    summary: LogSummary
    camera: Camera
    times_ms: Sequence[tuple[int, float]]
    has_lanes: bool

    @property
    def images_ns(self) -> dict[str, int]:
        """The stamp of each labelled image by its name in the converted dataset; empty for other logs."""
        record = next((found.values for found in self.summary.metadata if found.name == IMAGES_RECORD), ())
        return {name: found for name, stamp in record if (found := whole_number(stamp)) is not None}

    def frames(self) -> Iterator[RunFrame]:
        """Every frame in order; a frame that is only in the table has no lines.

        Raises:
            LogError: the log cannot be read.
            DecodeError: a message is not a roadperc.Lanes.
        """
        waiting = deque(self.times_ms)
        left = Counter(stamp_ns for stamp_ns, _ in waiting)
        for message in log.read(self.summary, topics=[LANES_TOPIC]):
            content = _decoded("lanes", message)
            boundaries = content.payload.boundaries if isinstance(content.payload, Lanes) else ()
            stamp_ns, lines_px = content.stamp_ns, tuple(b.line_px for b in boundaries if len(b.line_px))
            for earlier_ns, took_ms in _frames_before(waiting, stamp_ns, left):
                yield RunFrame(earlier_ns, (), took_ms)
            _, took_ms = waiting.popleft() if left[stamp_ns] > 0 else (stamp_ns, 0.0)
            left[stamp_ns] -= 1
            yield RunFrame(stamp_ns, lines_px, took_ms)
        yield from (RunFrame(stamp_ns, (), took_ms) for stamp_ns, took_ms in waiting)


def open_lanes(path: Path) -> RunLanes:
    """Open a run's lanes, their camera, and the metrics table beside the log.

    Raises:
        LogError: the log cannot be read, or has no lanes or no calibration of their camera.
        TableError: the table cannot be read.
    """
    summary = log.summarise(path)
    channels = summary.channels
    if not any(c.topic == LANES_TOPIC and c.schema_name == _SCHEMAS["lanes"] for c in channels):
        hint = "pass an OUT.mcap of roadperc-replay with lanes"
        raise LogError(f"{path}: no {LANES_TOPIC} of schema {_SCHEMAS['lanes']}; {hint}")
    frame_id = next((pb.Lanes.FromString(m.data).frame_id for m in log.read(summary, topics=[LANES_TOPIC])), None)
    topics = [c.topic for c in channels if c.schema_name == _SCHEMAS["calibration"]]
    return RunLanes(summary, _camera(summary, topics, frame_id), _times_ms(path), frame_id is not None)


def _frames_before(waiting: deque[tuple[int, float]], stamp_ns: int, left: Counter[int]) -> Iterator[tuple[int, float]]:
    """Take the frames before the next frame with this stamp, also in a later segment; else those of earlier stamps."""
    while waiting and (waiting[0][0] != stamp_ns if left[stamp_ns] > 0 else waiting[0][0] < stamp_ns):
        left[waiting[0][0]] -= 1
        yield waiting.popleft()


def default_rows(height: int) -> Float:
    """TuSimple's rows: multiples of 10 px from 160 to 710 for a height of 720, and the same ratio of other heights."""
    return np.arange(np.ceil(height * _TOP / ROW_STEP_PX) * ROW_STEP_PX, height, ROW_STEP_PX)


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
    lanes = (np.round(columns_at(line, rows, scaled), _DECIMALS) for line in lines if len(line))
    return LaneFrame(raw_file, rows, tuple(lane for lane in lanes if np.isfinite(lane).any()), frame.run_time_ms)


def _decoded(role: Kind, message: log.Message) -> Stamped:
    channel = message.channel
    kind = channel.schema_name, channel.message_encoding
    return decode(role, *kind, message.data, message.log_time_ns, Context())


def _camera(summary: LogSummary, topics: list[str], frame_id: str | None) -> Camera:
    for message in log.read(summary, topics=topics) if topics else ():
        camera = _decoded("calibration", message).payload
        if isinstance(camera, Camera) and frame_id in (None, camera.frame_id):
            return camera
    of_camera = f" of camera {frame_id!r} of {LANES_TOPIC}" if frame_id else ""
    raise LogError(f"{summary.path}: no calibration{of_camera}; expected one on any topic")


def _times_ms(path: Path) -> list[tuple[int, float]]:
    table = sidecar_path(path, "metrics")
    if not table.exists():
        return []
    run = open_run(table, path.stem)
    rows = rows_of(run).select(SEGMENT, "stamp_ns", "total_ms").sort(SEGMENT, "stamp_ns")
    return list(collect(rows.drop(SEGMENT), str(table)).iter_rows())
