"""Read the frames of a video file, one at a time, with their own times."""

import io
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
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
_ROUGH: Final = 0.02
"""Share by which a rate in a header, or a number of frames that follows from a duration, may be wrong."""
_HEAD_BYTES: Final = 1 << 16
_MP4_BOXES: Final = (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip")
_EBML, _SEGMENT = b"\x1aE\xdf\xa3", b"\x18S\x80g"
"""The ids at the begin of a Matroska file, and of its contents."""


@dataclass(frozen=True)
class VideoFile:
    """Facts of a video; columns and rows are those of the upright picture."""

    path: Path
    width: int
    height: int
    rate_hz: float
    count: int
    codec: str
    expects_count: bool = True
    """Whether fewer frames than ``count`` are a loss; else ``count`` are the frames that are there."""

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
        if self.damaged or (video.expects_count and lost > max(_ROUGH * video.count, 1)):
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
    """Return the facts of a video. Its frames are counted unless the header has their number, or the file is cut.

    Raises:
        DumpError: OpenCV cannot read the file or its codec, or it has no frame.
    """
    with open_capture(path, str(path.resolve())) as capture:
        codec = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace").strip("\0 ")
        if not _grabbed(capture)[0]:
            raise DumpError(
                f"{path}: no frame of the video can be read; it is empty, cut off or damaged, or OpenCV cannot decode "
                f"its codec, {codec or 'unknown'}: re-encode it with: ffmpeg -i {quote(str(path))} -c:v libx264 OUT.mp4"
            )
        width, height = (int(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        rate_hz, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
    rate_hz = rate_hz if 0 < rate_hz <= _HIGHEST_HZ else _USUAL_HZ
    if _expects_count(path):
        count = int(count) if math.isfinite(count) and count > 0 else 0
        return VideoFile(path, width, height, rate_hz, count, codec)
    count, mean_hz = _counted(path)
    is_near = abs(mean_hz / rate_hz - 1) <= _ROUGH or not 0 < mean_hz <= _HIGHEST_HZ
    return VideoFile(path, width, height, rate_hz if is_near else mean_hz, count, codec, expects_count=False)


def _expects_count(path: Path) -> bool:
    """Whether frames are missing if there are fewer than OpenCV says.

    The header of an MP4 has their number, except in fragments. Other files state a duration at most, and OpenCV
    multiplies it by a rate, which is wrong if the camera dropped frames. If the file is cut, some are missing.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    is_whole_mp4 = head[4:8] in _MP4_BOXES and b"mvex" not in head
    return is_whole_mp4 or _stated_size(head) > path.stat().st_size


def _stated_size(head: bytes) -> int:
    """Size that an AVI or Matroska file has by its header; 0 if it states none."""
    if head.startswith(b"RIFF"):
        return 8 + int.from_bytes(head[4:8], "little")
    rest = head.partition(_SEGMENT)[2]
    if not head.startswith(_EBML) or rest[:1] in (b"", b"\0"):
        return 0
    length = 9 - rest[0].bit_length()  # the first bit that is set gives the length of the number
    mask = (1 << 7 * length) - 1
    size = int.from_bytes(rest[:length]) & mask
    return 0 if size == mask else len(head) - len(rest) + length + size


def _counted(path: Path) -> tuple[int, float]:
    """The number of frames in a file, and their mean rate in Hz, 0 if unknown; nothing is decoded."""
    count, first_ms, last_ms = 0, math.inf, -math.inf
    with open_capture(path, str(path.resolve()), [cv2.CAP_PROP_FORMAT, -1]) as capture:
        while capture.grab():
            at_ms, count = capture.get(cv2.CAP_PROP_POS_MSEC), count + 1
            first_ms, last_ms = min(first_ms, at_ms), max(last_ms, at_ms)
    return count, 1000 * (count - 1) / (last_ms - first_ms) if last_ms > first_ms else 0.0


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
def open_capture(name: str | Path, source: str | io.BytesIO, options: Sequence[int] = ()) -> Iterator[cv2.VideoCapture]:
    """An open video, turned upright by its rotation.

    Args:
        name: names the video in the message of an error.
        source: an absolute path, because FFmpeg takes a name such as ``a:b`` for an address; or the bytes.
        options: pairs of a property and its value.

    Raises:
        DumpError: OpenCV cannot open it.
    """
    with quiet_opencv():  # lost frames are counted and reported here
        # the stubs of OpenCV know only one of both
        capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, options)  # type: ignore[arg-type]
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
