"""Videos of one camera as a recording: one file, or all files of a folder."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.formats.images import encode_jpeg
from roadperc_stream.log import Channel, Message
from roadperc_stream.model import Image
from roadperc_stream.output import encoding
from roadperc_stream.system.text import shown, whole_number
from roadperc_stream.system.threads import in_order

from .layouts.dataset import ConvertOptions
from .readers.documents import EPOCH_NS
from .recording import (
    JPEG_QUALITY,
    WORKERS,
    Recording,
    SensorRow,
    channels_of,
    finding_notes,
    rig_facts,
    static_messages,
    straightened,
)
from .rig import FRONT, Rig, build_rig
from .video_file import ReadCounts, VideoFile, frames_of, open_video

VIDEO_SUFFIXES: Final = frozenset({".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".ts", ".mts", ".mpg", ".mpeg"})
_FOLDER_OPTIONS: Final = ("--role", "--tags", "--rate", "--allow-lossy-tags", "--depth-coding", "--sequence")


def videos_in(folder: Path) -> list[Path]:
    """Return the videos of a folder in the order of their names, numbers by value."""
    found = [path for path in folder.iterdir() if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()]
    return sorted((path for path in found if not path.name.startswith(".")), key=_by_number)


def _by_number(path: Path) -> list[tuple[bool, int, str]]:
    parts = re.split(r"([0-9]+)", path.name)
    return [(number is None, number or 0, part) for part in parts for number in (whole_number(part),)]


def recording_of_videos(source: Path, paths: Sequence[Path], options: ConvertOptions) -> Recording:
    """Return the recording of videos; each continues the previous one after the interval of its frames.

    Args:
        source: the file or folder that the user named; ``calibration.json`` is in the folder.
        paths: the videos, in order.
        options: of the command line.

    Raises:
        DumpError: a video cannot be read or differs in size, the camera has no calibration, or an option is one of
            folders of frames.
    """
    why = "is an option for folders of frames; a video has its own times"
    options.refuse(source, _FOLDER_OPTIONS, why)
    videos = [open_video(path) for path in paths]
    first = videos[0]
    for video in videos[1:]:
        if (video.width, video.height) != (first.width, first.height):
            sizes = f"{video.width}x{video.height}, expected {first.width}x{first.height} as {first.path.name}"
            raise DumpError(f"{video.path}: {sizes}; convert videos of different cameras one by one")
    calibration, path = options.calibration_of(paths[0].parent)
    rig = build_rig(calibration, path, ["image"], {"image": (first.width, first.height)})
    camera = rig.cameras["calibration"]
    if (camera.width, camera.height) != (first.width, first.height):
        sizes = f"{first.width}x{first.height}, expected {camera.width}x{camera.height} as {path} says"
        raise DumpError(f"{first.path}: the video is {sizes}; use the calibration of this resolution")
    frames = sum(video.count for video in videos)
    timing = f"stamps of the video, {first.rate_hz:.4g} Hz in the mean"
    stored = f"{', '.join(dict.fromkeys(video.codec for video in videos))}, stored as jpeg {JPEG_QUALITY}"
    channels = channels_of([rig], ["image"])
    return Recording(
        title=f"{source}: {frames or 'an unknown number of'} frames",
        sensors=tuple(_row(video) for video in videos),
        facts=(("time", timing), *rig_facts(rig)),
        frames=frames,
        channels=channels,
        messages=lambda warnings: _messages(videos, rig, channels, warnings),
        required=("image",),
        metadata={"time": timing, "encoding.image": stored},
        notes=(*rig.notes, *finding_notes(rig)),
    )


def _row(video: VideoFile) -> SensorRow:
    size = f"{video.width}x{video.height}"
    return ("image", shown(video.path.name), str(video.count or ""), "", size, f"{video.codec}, stored as jpeg")


def _messages(
    videos: Sequence[VideoFile], rig: Rig, channels: Mapping[str, Channel], warnings: list[str]
) -> Iterator[tuple[str, Message]]:
    for role, data in static_messages(rig, EPOCH_NS):
        yield role, Message(channels[role], EPOCH_NS, EPOCH_NS, 0, data)
    camera = rig.cameras["calibration"]

    def encoded(item: tuple[int, Image]) -> tuple[int, bytes]:
        stamp_ns, pixels = item
        jpeg = encode_jpeg(straightened(camera, pixels), JPEG_QUALITY)
        return stamp_ns, encoding.encode_image(stamp_ns, FRONT, "jpeg", jpeg)

    for number, (stamp_ns, data) in enumerate(in_order(encoded, _stamped(videos, warnings), WORKERS)):
        yield "image", Message(channels["image"], stamp_ns, stamp_ns, number, data)


def _stamped(videos: Sequence[VideoFile], warnings: list[str]) -> Iterator[tuple[int, Image]]:
    """Yield stamp and pixels of all frames; appends what is missing in each video to ``warnings``."""
    start_ns = stamp_ns = EPOCH_NS
    for video in videos:
        counts = ReadCounts()
        for since_ns, pixels in frames_of(video, counts):
            stamp_ns = start_ns + since_ns
            yield stamp_ns, pixels
        warnings.extend(counts.warnings(video))
        start_ns = stamp_ns + video.interval_ns
