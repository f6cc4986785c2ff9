"""A log with ``foxglove.CompressedVideo`` as a recording: each frame becomes a JPEG, all other messages stay.

A frame of a video needs all frames since its key frame, so a replay cannot read one alone. OpenCV decodes H.264 from
memory: one key frame with its followers at a time, so that a frame belongs to its message even after damage.
"""

import io
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream import log
from roadperc_stream.errors import DumpError
from roadperc_stream.formats.images import encode_jpeg
from roadperc_stream.log import Channel, LogSummary, Message
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import stamp_ns
from roadperc_stream.schemas.topics import VIDEO_SCHEMA
from roadperc_stream.system.text import shown

from .carla_dump.messages import JPEG_QUALITY, channel_of
from .recording import Recording
from .video_file import open_capture

_KEY_FRAME: Final = re.compile(rb"\x00\x00\x01[\x07\x27\x47\x67]")
"""The start of a sequence parameter set, which each key frame has in an H.264 stream of Foxglove."""


def recording_of_log(path: Path) -> Recording:
    """Return the recording of a log with video.

    Raises:
        DumpError: the log has no H.264 video.
        LogError: the log cannot be read.
    """
    summary = log.summarise(path)
    videos = [c for c in summary.channels if (c.schema_name, c.message_encoding) == (VIDEO_SCHEMA, "protobuf")]
    if not videos:
        raise DumpError(f"{path}: a log without {VIDEO_SCHEMA}: roadperc-replay reads it as it is")
    counts = {channel.topic: summary.counts.get(channel.source_id, 0) for channel in videos}
    kept = {f"{c.topic} {c.source_id}": _as_images(c) if c in videos else c for c in summary.channels}
    return Recording(
        title=f"{path}: {sum(counts.values())} frames of video",
        sensors=tuple(("image", shown(topic), str(n), "", "", "h264, stored as jpeg") for topic, n in counts.items()),
        facts=(("time", "that of the messages"),),
        frames=sum(counts.values()),
        channels=kept,
        messages=lambda warnings: _messages(summary, videos, warnings),
        required=("image",),
        metadata={"time": "that of the messages", "encoding.image": f"h264, stored as jpeg {JPEG_QUALITY}"},
    )


def _as_images(channel: Channel) -> Channel:
    return replace(channel_of("image"), topic=channel.topic, source_id=channel.source_id)


def _messages(summary: LogSummary, videos: list[Channel], warnings: list[str]) -> Iterator[tuple[str, Message]]:
    decoded = {channel.topic: _decoded(summary, channel.topic, warnings) for channel in videos}
    for message in log.read(summary):
        if message.channel in videos:
            data = next(decoded[message.channel.topic])
            if data is not None:
                yield "image", replace(message, channel=_as_images(message.channel), data=data)
        else:
            yield message.channel.topic, message


def _decoded(summary: LogSummary, topic: str, warnings: list[str]) -> Iterator[bytes | None]:
    """Yield the image of each message on a topic; None for those that cannot be decoded."""
    group: list[CompressedVideo] = []
    for message in log.read(summary, topics=[topic]):
        frame = _frame(summary, message)
        if _KEY_FRAME.search(frame.data):
            yield from _images(topic, group, warnings)
            group = []
        group.append(frame)
    yield from _images(topic, group, warnings)


def _frame(summary: LogSummary, message: Message) -> CompressedVideo:
    where = f"{summary.path}: {message.channel.topic}: message at {message.log_time_ns} ns"
    try:
        frame = CompressedVideo.FromString(message.data)
    except ProtobufError as error:
        raise DumpError(f"{where}: not a {VIDEO_SCHEMA}: {error}") from error
    if frame.format != "h264":
        raise DumpError(
            f"{where}: video of format {frame.format!r}, expected h264; store it as foxglove.CompressedImage"
        )
    return frame


def _images(topic: str, group: list[CompressedVideo], warnings: list[str]) -> list[bytes | None]:
    """Return the images of a key frame and the frames up to the next one."""
    if not group:
        return []
    jpegs: list[bytes] = []
    if _KEY_FRAME.search(group[0].data):
        with open_capture(topic, io.BytesIO(b"".join(frame.data for frame in group))) as capture:
            while (found := capture.read())[0]:
                jpegs.append(encode_jpeg(np.asarray(found[1], np.uint8), JPEG_QUALITY))
    if len(jpegs) != len(group):
        first = stamp_ns(group[0].timestamp)
        warnings.append(f"{topic}: {len(group)} frames from {first} ns on are missing: {len(jpegs)} can be decoded")
        return [None] * len(group)
    pairs = zip(group, jpegs, strict=True)
    return [encoding.encode_image(stamp_ns(f.timestamp), f.frame_id, "jpeg", jpeg) for f, jpeg in pairs]
