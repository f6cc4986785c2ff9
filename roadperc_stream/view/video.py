"""Writes a video of a log's pictures, for people without a viewer: VP8 in WebM, or VP9 in MP4.

OpenCV's wheels can write these, and browsers play them. They have no H.264 encoder, and pass no options to an encoder.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from shlex import quote
from typing import Final, Self

import cv2
import numpy as np

from roadperc_stream import log
from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.formats import images
from roadperc_stream.input.stream import Problems
from roadperc_stream.log import LogSummary
from roadperc_stream.model import Image
from roadperc_stream.schemas.topics import METRICS_TOPIC, OVERLAY_TOPIC
from roadperc_stream.system.files import completing, require_free, require_suffix, scratch_folder
from roadperc_stream.system.pipeline import Pipeline
from roadperc_stream.system.process import without_native_messages
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.threads import usable_cores
from roadperc_stream.system.time import LONGEST_PAUSE_NS, NS_PER_S, ns_to_seconds
from roadperc_stream.view.pictures import Shot, shots
from roadperc_stream.view.result_frames import read_rows

CODECS: Final[Mapping[str, str]] = {".webm": "VP80", ".mp4": "vp09"}
"""Codec by suffix. VP9 takes 5 to 15 times as long as VP8, for 20 to 40 % fewer bytes."""
_ENCODED_HZ: Final = 1.0
"""libvpx uses its fast mode if a frame lasts as long as its deadline, 1 s. The real rate comes at the end."""
_MOST_COLUMNS: Final = 1280
"""Wider pictures are scaled down: the time of an encoder grows with the number of pixels."""
_NEVER: Final = 2**31 - 1
"""Interval of key frames, so that only those of the encoder are marked: browsers refuse wrong marks."""
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
    source: log.AnyLog,
    target: Path,
    topic: str = OVERLAY_TOPIC,
    *,
    force: bool = False,
    progress: Callable[[int, int], None] = no_progress,
) -> Video:
    """Write a video of the overlays in a log, or of its debug pictures on a topic; without overlays, draw them.

    The video runs at the log's pace. Its rate is that of the median interval between stamps. Faster frames are left
    out. In a gap the last picture stays, for 10 s at most. ``source`` is a log that ``roadperc-replay`` wrote;
    ``target`` ends with one of ``CODECS``.

    Raises:
        LogError: the log is unreadable, or has no results or no pictures.
        TargetError: the video exists and ``force`` is not set, or it cannot be completed; no partial file remains.
    """
    require_suffix(target, *CODECS)
    require_free(target, force=force, source=log.LogFile.of(source).name, suffix=target.suffix.lower())
    summary, problems = log.summarise(source), Problems()
    stamps = _frame_stamps(summary)
    rate_hz, done = frame_rate_hz(stamps), iter(range(1, len(stamps) + 1))
    with (
        completing(target, force=force) as temporary,
        scratch_folder(target) as folder,
        images.quiet_opencv(),
        _VideoWriter(target, temporary, folder / f"slow{target.suffix}", rate_hz) as video,
    ):
        shown = zip(shots(summary, topic, problems, _MOST_COLUMNS), pictures_shown(stamps, rate_hz), strict=True)
        pipeline: Pipeline[tuple[Shot, int]] = Pipeline(shown)
        drawn = pipeline.then(lambda shot: (video.fitted(shot[0]()), shot[1]))
        written = drawn.then(lambda shot: video.show(*shot))
        written.then(lambda _: progress(next(done), len(stamps))).run(usable_cores())
        if not video.pictures:
            why = "".join(f"; {text}" for text in problems.first.values())
            what = "camera image" if topic == OVERLAY_TOPIC else f"picture on {topic}"
            raise LogError(f"{source}: no {what} in any of {len(stamps)} frames{why}")
    return Video(video.pictures, rate_hz, len(stamps), problems)


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


class _VideoWriter:
    """Writes a video of the size of its first picture to ``temporary``, a partial file of ``target``.

    The pictures are encoded into the file ``slow`` at ``_ENCODED_HZ``. At the end they get their times.
    """

    def __init__(self, target: Path, temporary: Path, slow: Path, rate_hz: float) -> None:
        self.pictures = 0
        self._target, self._temporary, self._slow, self._rate_hz = target, temporary, slow, rate_hz
        self._writer: cv2.VideoWriter | None = None
        self._last: Image | None = None
        self._size: tuple[int, int] | None = None

    def show(self, picture: Image | None, times: int) -> None:
        """Write a picture ``times`` times; None repeats the previous one."""
        self._last = self._last if picture is None else picture
        if self._last is None:
            return
        if self._writer is None:
            self._writer = self._opened(self._slow, _ENCODED_HZ)
        for _ in range(times):
            self._writer.write(self._last)
        self.pictures += times

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._writer is not None:
            self._writer.release()
        if kind is None and self._writer is not None and self._retimed() != self.pictures:
            raise TargetError(f"{self._target}: the video is incomplete; check the free disk space")

    def fitted(self, picture: Image | None) -> Image | None:
        """Scale to the video's size. Its sides are even, as the codecs halve the resolution of colours."""
        if picture is None:
            return None
        if self._size is None:
            scale = min(_MOST_COLUMNS / picture.shape[1], 1.0)
            rows, columns = (2 * max(int(side * scale / 2), 1) for side in picture.shape[:2])
            self._size = columns, rows
        if picture.shape[1::-1] == self._size:
            return picture
        return np.asarray(cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA), np.uint8)

    def _opened(self, path: Path, rate_hz: float, *options: int) -> cv2.VideoWriter:
        assert self._size is not None  # of the first picture
        fourcc = cv2.VideoWriter.fourcc(*CODECS[self._target.suffix.lower()])
        with without_native_messages():  # about a tag, which WebM does not have
            writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, rate_hz, self._size, options)
        if not writer.isOpened():
            raise TargetError(
                f"{self._target}: cannot write the video; check the folder and that OpenCV has the encoder"
            )
        return writer

    def _retimed(self) -> int:
        """Copy the encoded pictures to the file with the real rate; returns the number of those that are whole."""
        raw = cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1, cv2.VIDEOWRITER_PROP_KEY_INTERVAL, _NEVER
        writer = self._opened(self._temporary, self._rate_hz, *raw)
        capture = _encoded(self._slow)
        while capture.grab():
            _, data = capture.retrieve()
            writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, capture.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME))
            writer.write(data)
        writer.release()
        return sum(1 for _ in iter(_encoded(self._temporary).grab, False))


def _encoded(path: Path) -> cv2.VideoCapture:
    """A video as encoded pictures; without any if it cannot be read."""
    return cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
