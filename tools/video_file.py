"""Read the frames of a video file, one at a time, with their own times."""

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.formats.images import quiet_opencv
from roadperc_stream.model import Image
from roadperc_stream.system.time import NS_PER_S

_MOST_FAILURES: Final = 1000
"""Reading goes on after this many damaged packets in a row; at the end of the file each attempt takes microseconds."""
_HIGHEST_HZ: Final = 1000.0
"""Higher rates are clocks of the container, not rates of a camera."""
_USUAL_HZ: Final = 25.0
_NS_PER_MS: Final = 1_000_000
_ROUGH_COUNT: Final = 0.02
"""A Matroska header states a duration, so the number of frames that follows from it may be this share too high."""


@dataclass(frozen=True)
class VideoFile:
    """What the header of a video states; columns and rows are those of the upright picture."""

    path: Path
    width: int
    height: int
    rate_hz: float
    count: int
    codec: str

    @property
    def interval_ns(self) -> int:
        """Nanoseconds between frames at the stated rate."""
        return round(NS_PER_S / self.rate_hz)


@dataclass
class ReadCounts:
    """The frames of a video, counted while it is read."""

    read: int = 0
    damaged: int = 0
    """Packets between two frames that could not be decoded."""
    untimed: int = 0
    """Frames without a time after that of the previous frame."""

    def warnings(self, video: VideoFile) -> Iterator[str]:
        """Yield what the user must know about a video that was read to its end."""
        lost = video.count - self.read
        if self.damaged or lost > max(_ROUGH_COUNT * video.count, 1):
            stated = max(video.count, self.read + self.damaged)
            inside = f" ({self.damaged} damaged ones lie between them)" if self.damaged else ""
            yield (
                f"{video.path}: {self.read} of {stated} frames could be read{inside}. The log has all of them; "
                "the file is cut, damaged or trimmed: copy it again if the original is longer"
            )
        if self.untimed:
            rate = f"{video.rate_hz:g} Hz"
            yield f"{video.path}: {self.untimed} frames have no time of their own; they follow at the rate {rate}"


def open_video(path: Path) -> VideoFile:
    """Return what the header of a video states.

    Raises:
        DumpError: OpenCV cannot read the file, or it has no frame.
    """
    with open_capture(path, str(path.resolve())) as capture:
        if not _grabbed(capture)[0]:
            raise DumpError(f"{path}: the video has no frame that can be read; it is empty, cut off or damaged")
        width, height = (int(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        rate_hz, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
        codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace").strip("\0 ")
    known = 0 < rate_hz <= _HIGHEST_HZ
    count = int(count) if math.isfinite(count) and count > 0 else 0
    return VideoFile(path, width, height, rate_hz if known else _USUAL_HZ, count, codec)


def frames_of(video: VideoFile, counts: ReadCounts) -> Iterator[tuple[int, Image]]:
    """Yield nanoseconds since the first frame, strictly increasing, and (H, W, 3) pixels, upright.

    Reading goes on after damage. ``counts`` is complete when the iteration has ended.
    """
    with open_capture(video.path, str(video.path.resolve())) as capture:
        first_ns = last_ns = None
        while (found := _grabbed(capture))[0]:
            is_decoded, pixels = capture.retrieve()
            counts.damaged += found[1] + (not is_decoded)
            if not is_decoded:
                continue
            stamp_ns = round(capture.get(cv2.CAP_PROP_POS_MSEC) * _NS_PER_MS)
            first_ns = stamp_ns if first_ns is None else first_ns
            since_ns = stamp_ns - first_ns
            if last_ns is not None and since_ns <= last_ns:
                counts.untimed += 1
                since_ns = last_ns + video.interval_ns
            last_ns = since_ns
            counts.read += 1
            yield since_ns, np.asarray(pixels, np.uint8)


def _grabbed(capture: cv2.VideoCapture) -> tuple[bool, int]:
    """Whether there is a next frame, and the number of damaged packets before it."""
    for failures in range(_MOST_FAILURES):
        if capture.grab():
            return True, failures
    return False, 0


@contextmanager
def open_capture(name: str | Path, source: str | io.BytesIO) -> Iterator[cv2.VideoCapture]:
    """An open video, turned upright by its rotation.

    Args:
        name: names the video in the message of an error.
        source: an absolute path, because FFmpeg takes a name such as ``a:b`` for an address; or the bytes.

    Raises:
        DumpError: OpenCV cannot open it.
    """
    with quiet_opencv():  # lost frames are counted and reported here
        # the stubs of OpenCV know only one of both
        capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, [])  # type: ignore[arg-type]
    try:
        if not capture.isOpened():
            raise DumpError(
                f"{name}: not a video that OpenCV can read; a recorder that stopped early leaves an MP4 without its "
                "index: repair it with the recorder's tool"
            )
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        yield capture
    finally:
        capture.release()
