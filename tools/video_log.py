"""A log with video as a recording: each frame becomes a JPEG, all other messages stay.

A frame of a video needs all frames since its key frame, so a replay cannot read one alone. OpenCV decodes H.264 and
H.265 from memory: one key frame with its followers at a time, so that a frame belongs to its message even after damage.
"""

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.errors import DecodeError, DumpError
from roadperc_stream.formats.images import encode_jpeg, video_codec
from roadperc_stream.input.decoding import context_of_channel, decode, schemas_of_kind
from roadperc_stream.log import Channel, LogSummary, Message
from roadperc_stream.model import VideoFrame
from roadperc_stream.output import encoding
from roadperc_stream.output.input_log import channel_of
from roadperc_stream.schemas.topics import VIDEO_SCHEMAS
from roadperc_stream.system.text import shown

from .recording import JPEG_QUALITY, Recording
from .video_file import open_capture

_KEY_FRAMES: Final = {
    "h264": re.compile(rb"\x00\x00\x01[\x07\x27\x47\x67]"),
    "h265": re.compile(rb"\x00\x00\x01[\x42\x43]"),
}
"""The start of a sequence parameter set, which each key frame has in a stream of Foxglove, by codec."""


def recording_of_log(path: Path) -> Recording:
    """Return the recording of a log or ROS bag with video.

    Raises:
        DumpError: the log has no video, or in a codec or message encoding that cannot be decoded.
        LogError: the log cannot be read.
    """
    summary = log.summarise(log.received([path]))
    videos = videos_of(summary)
    if not videos:
        raise DumpError(f"{path}: a log without video; replay it with: roadperc-replay {quote(str(path))} OUT.mcap")
    for channel, codec in videos.items():
        _require_codec(f"{path}: {channel.topic}", codec)
    counts = {channel.topic: summary.counts.get(channel.source_id, 0) for channel in videos}
    codecs = {channel.topic: codec for channel, codec in videos.items()}
    kept = {f"{c.topic} {c.source_id}": _as_images(c) if c in videos else c for c in summary.channels}
    return Recording(
        title=f"{path}: {sum(counts.values())} frames of video",
        sensors=tuple(("image", shown(t), str(n), "", "", f"{codecs[t]}, stored as jpeg") for t, n in counts.items()),
        facts=(("time", "that of the messages"),),
        frames=sum(counts.values()),
        channels=kept,
        messages=lambda warnings: _messages(summary, videos, warnings),
        required=("image",),
        metadata={
            "time": "that of the messages",
            "encoding.image": f"{', '.join(dict.fromkeys(codecs.values()))}, stored as jpeg {JPEG_QUALITY}",
        },
    )


def videos_of(summary: LogSummary) -> dict[Channel, str]:
    """Return the codec of each channel with video, by the format of its first message.

    Raises:
        DumpError: a message of video cannot be read.
    """
    found = {}
    for channel in summary.channels:
        is_video = channel.schema_name in VIDEO_SCHEMAS
        kind = channel.schema_name, channel.message_encoding
        if (is_video or kind in schemas_of_kind("video")) and summary.counts.get(channel.source_id):
            first = next(m for m in log.read(summary, topics=[channel.topic]) if m.channel == channel)
            try:
                layout = _packet(summary, first)[1].format
            except DumpError:
                if is_video:
                    raise
                continue  # a replay reports images that cannot be read
            if is_video or video_codec(layout):
                found[channel] = video_codec(layout) or layout
    return found


def _require_codec(where: str, codec: str) -> None:
    if codec not in _KEY_FRAMES:
        expected = " or ".join(_KEY_FRAMES)
        raise DumpError(f"{where}: video of codec {codec!r}, expected {expected}; store it as foxglove.CompressedImage")


def _as_images(channel: Channel) -> Channel:
    return replace(channel_of("image"), topic=channel.topic, source_id=channel.source_id)


def _messages(summary: LogSummary, videos: Mapping[Channel, str], warnings: list[str]) -> Iterator[tuple[str, Message]]:
    decoded = {channel: _decoded(summary, channel, codec, warnings) for channel, codec in videos.items()}
    for message in log.read(summary):
        if message.channel in videos:
            data = next(decoded[message.channel])
            if data is not None:
                yield "image", replace(message, channel=_as_images(message.channel), data=data)
        else:
            yield message.channel.topic, message


def _decoded(summary: LogSummary, channel: Channel, codec: str, warnings: list[str]) -> Iterator[bytes | None]:
    """Yield the image of each message of a channel; None for those that cannot be decoded."""
    group: list[tuple[int, VideoFrame]] = []
    for message in log.read(summary, topics=[channel.topic]):
        if message.channel != channel:
            continue
        stamp_ns, packet = _packet(summary, message)
        if video_codec(packet.format) != codec:
            raise DumpError(f"{_where(summary, message)}: format {packet.format!r}, expected {codec} as before")
        if _KEY_FRAMES[codec].search(packet.data):
            yield from _images(channel.topic, codec, group, warnings)
            group = []
        group.append((stamp_ns, packet))
    yield from _images(channel.topic, codec, group, warnings)


def _where(summary: LogSummary, message: Message) -> str:
    return f"{summary.path}: {message.channel.topic}: message at {message.log_time_ns} ns"


def _packet(summary: LogSummary, message: Message) -> tuple[int, VideoFrame]:
    """Return the stamp of a message in nanoseconds, and its content.

    Raises:
        DumpError: its encoding is not read, or its bytes do not match its schema.
    """
    channel, content = message.channel, (message.data, message.log_time_ns, context_of_channel(message.channel, "auto"))
    try:
        found = decode("video", channel.schema_name, channel.message_encoding, *content)
    except DecodeError as error:
        raise DumpError(f"{_where(summary, message)}: {error}") from error
    assert isinstance(found.payload, VideoFrame)
    return found.stamp_ns, found.payload


def _images(topic: str, codec: str, group: list[tuple[int, VideoFrame]], warnings: list[str]) -> list[bytes | None]:
    """Return the images of a key frame and the frames up to the next one."""
    if not group:
        return []
    jpegs: list[bytes] = []
    if _KEY_FRAMES[codec].search(group[0][1].data):
        content = io.BytesIO(b"".join(packet.data for _, packet in group))
        with suppress(DumpError), open_capture(topic, content) as capture:  # the warning names frames that are missing
            while (found := capture.read())[0]:
                jpegs.append(encode_jpeg(np.asarray(found[1], np.uint8), JPEG_QUALITY))
    if len(jpegs) != len(group):
        first = group[0][0]
        warnings.append(f"{topic}: {len(group)} frames from {first} ns on are missing: {len(jpegs)} can be decoded")
        return [None] * len(group)
    pairs = zip(group, jpegs, strict=True)
    return [encoding.encode_image(stamp_ns, packet.frame_id, "jpeg", jpeg) for (stamp_ns, packet), jpeg in pairs]
