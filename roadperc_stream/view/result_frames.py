"""Reads a log with results frame by frame: rows, pictures and stage times."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Any, Final, TypeVar

from roadperc_stream import log
from roadperc_stream.errors import ChannelError, DecodeError, LogError
from roadperc_stream.geometry import Camera
from roadperc_stream.input.calibrations import calibration_role
from roadperc_stream.input.decoding import Stamped, context_of_channel, decode
from roadperc_stream.input.earlier_replay import is_result, is_result_of
from roadperc_stream.input.rectified import rectified
from roadperc_stream.input.replaced import first_latched
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.stream import Problems, RoleAssignment
from roadperc_stream.log import LogSummary, Message
from roadperc_stream.model import Absent, CameraImage, Lanes, Mask, Objects, Reason, TagImage
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14
from roadperc_stream.output.drawing.overlay import PerceivedFrame
from roadperc_stream.output.results import decode_metrics
from roadperc_stream.output.tables import read_rows_around
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics
from roadperc_stream.schemas.roles import Kind
from roadperc_stream.schemas.topics import DRIVABLE_TOPIC, LANES_TOPIC, METRICS_TOPIC, OBJECTS_TOPIC
from roadperc_stream.system.time import NS_PER_S

TimesMs = Mapping[str, float]
"""Milliseconds by time column; stages that did not run are left out."""
TimesOfFrame = Callable[[str, int], TimesMs]
"""The times of a frame by ``log_id`` and ``frame``, in any order; empty if unknown."""


class TableTimes:
    """Stage times from ``OUT.metrics.parquet``, if it exists. Holds one row group."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rows: dict[int, dict[str, Any]] = {}

    def of(self, log_id: str, frame: int) -> TimesMs:
        """The times of a frame; empty if the table lacks the frame or belongs to another log.

        Raises:
            TableError: the table cannot be read.
        """
        if frame not in self._rows:
            exists = self._path.exists()
            rows = read_rows_around(self._path, frame, ("log_id", *TIME_COLUMNS)) if exists else []
            self._rows = {frame: {}} | {row["frame"]: row for row in rows}
        row = self._rows[frame]
        return _known(row) if row.get("log_id") == log_id else {}


class ReplayTimes:
    """Stage times of a running replay; a few doubles per frame."""

    def __init__(self) -> None:
        self._times_ms: dict[tuple[str, int], tuple[float | None, ...]] = {}

    def note(self, row: FrameMetrics, times_ms: TimesMs) -> None:
        """Record the times of a frame."""
        self._times_ms[row.log_id, row.frame] = tuple(times_ms.get(column) for column in TIME_COLUMNS)

    def of(self, log_id: str, frame: int) -> TimesMs:
        """The times of a frame; empty until it is done."""
        return _known(dict(zip(TIME_COLUMNS, self._times_ms.get((log_id, frame), ()), strict=False)))


def _known(row: Mapping[str, float | None]) -> TimesMs:
    return {column: value for column in TIME_COLUMNS if (value := row.get(column)) is not None}


def require_shown(summary: LogSummary, roles: RoleAssignment) -> None:
    """Check that some messages of a log have a role or are results.

    Raises:
        LogError: there are no such messages; the text names topics that could fill a role.
    """
    holding = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    if not holding:
        raise LogError(f"{summary.path}: the log has no messages to show")
    if not roles.topics and not any(is_result_of(channel, channel.topic) for channel in holding):
        raise nothing_shown(summary.path, roles.unassigned)


def nothing_shown(path: Path, reasons: Iterable[str]) -> LogError:
    """The error for a log with nothing to show; it names commands that show any log."""
    named = quote(str(path))
    elsewhere = f"try rerun {named} or roadperc-view {named} --foxglove"
    return LogError("; ".join((f"{path}: no topic that roadperc-view can show", *reasons, elsewhere)))


Content = TypeVar("Content")
LATENESS_NS: Final = (0, 2 * NS_PER_S)
"""Tried limits of the difference between log time and stamp; little is read with the first one."""
_KINDS: Final[Mapping[str, Kind]] = {LANES_TOPIC: "lanes", OBJECTS_TOPIC: "objects", DRIVABLE_TOPIC: "tags"}
_MOST_WAITING: Final = 64
"""Most stamps that wait for metrics. Messages without a frame never get metrics."""


def read_frame(path: Path, stamp_ns: int, problems: Problems) -> PerceivedFrame | None:
    """The frame of a stamp; None without a camera image. Reads only the log around the stamp.

    ``problems`` collects unreadable messages; a message near two frames counts twice.

    Raises:
        LogError: the log cannot be read.
    """
    summary = log.summarise(path)
    for lateness_ns in LATENESS_NS:
        span_ns = max(stamp_ns - lateness_ns, 0), stamp_ns + lateness_ns + 1
        for row, frame in read_frames(summary, problems, span_ns):
            if row.stamp_ns == stamp_ns and frame is not None:
                return frame
    return None


def read_frames(
    summary: LogSummary, problems: Problems, span_ns: tuple[int, int | None] = (0, None)
) -> Iterator[tuple[FrameMetrics, PerceivedFrame | None]]:
    """The row and the results of every frame in a span of log time, in order; no results without a camera image.

    The image is the rectified one of the camera of the results. Frames with an unreadable row are left out. Other
    unreadable messages count as absent. Holds a few frames in memory. ``problems`` collects unreadable messages.

    Raises:
        LogError: the log cannot be read.
    """
    image_topic, camera = _image_source(summary)
    waiting: dict[int, dict[str, Stamped]] = {}
    topics, (start_ns, end_ns) = {image_topic, METRICS_TOPIC, *_KINDS}, span_ns
    for message in log.read(summary, topics=topics, start_ns=start_ns, end_ns=end_ns):
        if row := row_of(message, problems):
            found = waiting.pop(row.stamp_ns, {})
            yield row, _frame_of(found, (image_topic, camera), row, problems)
            waiting = {stamp_ns: found for stamp_ns, found in waiting.items() if stamp_ns > row.stamp_ns}
        elif content := _decoded(message, image_topic, problems):
            waiting.setdefault(content.stamp_ns, {})[message.channel.topic] = content
            if len(waiting) > _MOST_WAITING:
                waiting.pop(next(iter(waiting)))


def read_rows(summary: LogSummary, problems: Problems) -> Iterator[tuple[int, FrameMetrics]]:
    """Log time and row of every frame with a readable row, in order; empty without results.

    ``problems`` collects unreadable messages.

    Raises:
        LogError: the log cannot be read.
    """
    for message in log.read(summary, topics=(METRICS_TOPIC,)):
        if row := row_of(message, problems):
            yield message.log_time_ns, row


def row_of(message: Message, problems: Problems) -> FrameMetrics | None:
    """The row of a metrics message; None for other messages and for unreadable ones, which are counted."""
    if not is_result_of(message.channel, METRICS_TOPIC):
        return None
    return content_of(lambda: decode_metrics(message.data), METRICS_TOPIC, message.log_time_ns, problems)


def content_of(content: Callable[[], Content], topic: str, time_ns: int, problems: Problems) -> Content | None:
    """The decoded content of a message; None if it cannot be read, which is counted."""
    try:
        return content()
    except DecodeError as error:
        problems.add(topic, time_ns, error)
        return None


_ImageSource = tuple[str, Camera | None]
"""The image topic that the replay used, empty if the log no longer has it, and its first calibration."""


def _image_source(summary: LogSummary) -> _ImageSource:
    try:
        roles = assignment_of_log(summary, {})
    except ChannelError:  # the roles of the input are ambiguous
        return "", None
    role, cameras = "image" if "image" in roles.topics else "left", first_latched(summary, roles).cameras
    return roles.topics.get(role, ""), cameras.get(calibration_role(role, cameras))


def _frame_of(
    found: Mapping[str, Stamped], source: _ImageSource, row: FrameMetrics, problems: Problems
) -> PerceivedFrame | None:
    topic, camera = source
    image = rectified(_result(found, topic, CameraImage, "image"), camera)
    if isinstance(image, Absent):
        return None
    image_bgr = content_of(lambda: image.bgr, topic, row.stamp_ns, problems)
    if image_bgr is None:
        return None
    mask = content_of(lambda: _drivable(found), DRIVABLE_TOPIC, row.stamp_ns, problems)
    drivable = _drivable({}) if mask is None else mask
    wrong_size = any((reason.source, reason.code) == ("image", "wrong_size") for reason in row.reasons)
    # If the mask has another size, mask, lanes and objects belong to another camera.
    fits = not wrong_size and (isinstance(drivable, Absent) or drivable.shape == image_bgr.shape[:2])
    lanes = _result(found, LANES_TOPIC, Lanes, "lanes")
    return PerceivedFrame(image_bgr, lanes, _result(found, OBJECTS_TOPIC, Objects, "objects"), drivable, fits)


def _decoded(message: Message, image_topic: str, problems: Problems) -> Stamped | None:
    channel, log_time_ns = message.channel, message.log_time_ns
    if is_result(channel):
        kind = _KINDS.get(channel.topic) if is_result_of(channel, channel.topic) else None
    else:
        kind = "image" if channel.topic == image_topic else None
    if kind is None:  # not drawn
        return None
    # The decoder requires a tag table, although a mask has no tags.
    context = replace(context_of_channel(channel, "auto"), tag_table=CARLA_BEFORE_0_9_14)
    schema, encoding = channel.schema_name, channel.message_encoding
    return content_of(
        lambda: decode(kind, schema, encoding, message.data, log_time_ns, context), channel.topic, log_time_ns, problems
    )


def _result(found: Mapping[str, Stamped], topic: str, kind: type[Content], name: str) -> Content | Absent:
    payload = found[topic].payload if topic in found else None
    return payload if isinstance(payload, kind) else Absent(Reason(name, "not_in_log"))


def _drivable(found: Mapping[str, Stamped]) -> Mask | Absent:
    tags = _result(found, DRIVABLE_TOPIC, TagImage, "drivable")
    return tags if isinstance(tags, Absent) else tags.tags > 0
