"""Writes a video of a log's overlays, for people without a viewer: VP9 in an MP4 file.

OpenCV's wheels can write VP9, which browsers play. They have no H.264 encoder.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Final, Self

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream import log
from roadperc_stream.errors import DecodeError, LogError, TargetError
from roadperc_stream.formats import images
from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import LogSummary
from roadperc_stream.model import Image
from roadperc_stream.output.drawing.overlay import draw_frame
from roadperc_stream.schemas.topics import METRICS_TOPIC, OVERLAY_TOPIC
from roadperc_stream.system.files import completing, require_free
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.time import LONGEST_PAUSE_NS, NS_PER_S, ns_to_seconds
from roadperc_stream.view.result_frames import content_of, read_frames, read_rows, row_of

_CODEC: Final = "vp09"
_MOST_COLUMNS: Final = 1280
"""Wider pictures are scaled down: the time of VP9 grows with the number of pixels."""
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 120.0
_LONGEST_STILL_S: Final = 10.0


@dataclass(frozen=True)
class Video:
    """Number of pictures, their rate, and the number of the log's frames."""

    pictures: int
    rate_hz: float
    frames: int
    problems: Problems
    """Messages that could not be read and are not drawn."""


def write_video(
    source: log.AnyLog, target: Path, *, force: bool = False, progress: Callable[[int, int], None] = no_progress
) -> Video:
    """Write a video of the overlays in a log; without overlays, draw the results into the camera image.

    The video runs at the log's pace. Its rate is that of the median interval between stamps. Faster frames are left
    out. In a gap the last picture stays, for 10 s at most. ``source`` is a log that ``roadperc-replay`` wrote;
    ``target`` ends with ``.mp4``.

    Raises:
        LogError: the log is unreadable, or has no results or no pictures.
        TargetError: the video exists and ``force`` is not set, or it cannot be completed; no partial file remains.
    """
    require_free(target, force=force, source=log.LogFile.of(source).name, suffix=".mp4")
    summary, problems = log.summarise(source), Problems()
    stamps = _frame_stamps(summary)
    rate_hz, frames = frame_rate_hz(stamps), 0
    with (
        completing(target, force=force) as temporary,
        images.quiet_opencv(),
        _VideoWriter(target, temporary, rate_hz) as video,
    ):
        shots = zip(_shots(summary, problems), pictures_shown(stamps, rate_hz), strict=True)
        for frames, (picture, times) in enumerate(shots, 1):
            video.show(picture, times)
            progress(frames, len(stamps))
        if not video.pictures:
            why = "".join(f"; {text}" for text in problems.first.values())
            raise LogError(f"{source}: no camera image in any of {frames} frames{why}")
    return Video(video.pictures, rate_hz, frames, problems)


def _frame_stamps(summary: LogSummary) -> list[int]:
    source, problems = summary.path, Problems()
    stamps = [row.stamp_ns for _, row in read_rows(summary, problems)]
    if not stamps:
        why = problems.first.get(METRICS_TOPIC, f"run roadperc-replay {quote(str(source))} OUT.mcap first")
        raise LogError(f"{source}: no results for a video; {why}")
    return stamps


def frame_rate_hz(stamps_ns: Sequence[int]) -> float:
    """Rate of the median interval between frames, 1 to 120 Hz; stamps that go back do not count."""
    forward = [later - earlier for earlier, later in pairwise(stamps_ns) if later > earlier]
    return float(np.clip(NS_PER_S / np.median(forward), _SLOWEST_HZ, _FASTEST_HZ)) if forward else _SLOWEST_HZ


def pictures_shown(stamps_ns: Sequence[int], rate_hz: float) -> list[int]:
    """The number of video pictures of each frame, so that video time follows the stamps.

    0 for a frame that is faster than the video rate, 1 at the end of a segment.
    """
    elapsed, ticks = 0.0, [0]
    for earlier, later in pairwise(stamps_ns):
        seconds, is_same = ns_to_seconds(later - earlier), 0 < later - earlier <= LONGEST_PAUSE_NS
        elapsed += min(seconds, _LONGEST_STILL_S) if is_same else 1 / rate_hz
        # Rounding to the nearest picture keeps regular intervals regular.
        ticks.append(int(elapsed * rate_hz + 0.5))
    return [later - earlier for earlier, later in pairwise([*ticks, ticks[-1] + 1])]


def _shots(summary: LogSummary, problems: Problems) -> Iterator[Image | None]:
    """The picture of every frame in order; None without an image."""
    written = [channel for channel in summary.channels if is_result_of(channel, OVERLAY_TOPIC)]
    if any(summary.counts.get(channel.source_id) for channel in written):
        yield from _overlays(summary, problems)
        return
    first_ns: int | None = None
    for row, frame in read_frames(summary, problems):
        first_ns = row.stamp_ns if first_ns is None else first_ns
        since_start_s = ns_to_seconds(row.stamp_ns - first_ns)
        width_px = 0 if frame is None else min(frame.image_bgr.shape[1], _MOST_COLUMNS)
        yield None if frame is None else draw_frame(frame, row, since_start_s, width_px)


def _overlays(summary: LogSummary, problems: Problems) -> Iterator[Image | None]:
    """The overlays of a log. Each follows the metrics of its frame."""
    frames, picture = 0, None
    for message in log.read(summary, topics=(OVERLAY_TOPIC, METRICS_TOPIC)):
        if is_result_of(message.channel, OVERLAY_TOPIC):
            picture = content_of(partial(_decoded, message.data), OVERLAY_TOPIC, message.log_time_ns, problems)
        elif row_of(message, problems):
            if frames:
                yield picture
            frames, picture = frames + 1, None
    if frames:
        yield picture


def _decoded(data: bytes) -> Image:
    try:
        return images.decode_bgr(CompressedImage.FromString(data).data)
    except ProtobufError as error:
        raise DecodeError(f"{len(data)} bytes are not a foxglove.CompressedImage: {error}") from error


class _VideoWriter:
    """Writes a video of the size of its first picture to a partial file of ``target``."""

    def __init__(self, target: Path, temporary: Path, rate_hz: float) -> None:
        self.pictures = 0
        self._target, self._temporary, self._rate_hz = target, temporary, rate_hz
        self._writer: cv2.VideoWriter | None = None
        self._last: Image | None = None

    def show(self, picture: Image | None, times: int) -> None:
        """Write a picture ``times`` times; None repeats the previous one."""
        if picture is not None:
            self._last = self._fitted(picture)
        if self._last is None:
            return
        if self._writer is None:
            self._writer = self._opened(self._last)
        for _ in range(times):
            self._writer.write(self._last)
        self.pictures += times

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._writer is not None:
            self._writer.release()
        if kind is None and _pictures_in(self._temporary) != self.pictures:
            raise TargetError(f"{self._target}: the video is incomplete; check the free disk space")

    def _fitted(self, picture: Image) -> Image:
        """Scale to the video's size. Its sides are even, as VP9 halves the resolution of colours."""
        if self._last is not None:
            rows, columns = self._last.shape[:2]
        else:
            scale = min(_MOST_COLUMNS / picture.shape[1], 1.0)
            rows, columns = (2 * max(int(side * scale / 2), 1) for side in picture.shape[:2])
        if picture.shape[:2] == (rows, columns):
            return picture
        return np.asarray(cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)

    def _opened(self, picture: Image) -> cv2.VideoWriter:
        rows, columns = picture.shape[:2]
        fourcc = cv2.VideoWriter.fourcc(*_CODEC)
        writer = cv2.VideoWriter(str(self._temporary), cv2.CAP_FFMPEG, fourcc, self._rate_hz, (columns, rows))
        if not writer.isOpened():
            raise TargetError(
                f"{self._target}: cannot write the video; check the folder and that OpenCV has a VP9 encoder"
            )
        return writer


def _pictures_in(path: Path) -> int:
    """The number of pictures in a video; 0 if it cannot be read."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    capture.release()
    return count
