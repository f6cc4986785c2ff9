"""Small videos with known times, rotation and damage."""

import struct
from itertools import pairwise

import cv2
import numpy as np

WIDTH, HEIGHT, RATE_HZ = 160, 120, 20
BOXES = (b"moov", b"trak", b"mdia", b"minf", b"stbl")
QUARTER_TURN = (0, 1 << 16, 0, -(1 << 16), 0, 0, HEIGHT << 16, 0, 1 << 30)
"""The display matrix of an MP4 that turns the picture clockwise: a, b, u, c, d, v, x, y, w."""


def picture(number, width=WIDTH, height=HEIGHT):
    """(H, W, 3) with a white corner at the top left and a green bar that is wider in each frame."""
    pixels = np.zeros((height, width, 3), np.uint8)
    pixels[height // 2 :, : 6 * number + 6] = (20, 200, 60)
    pixels[:20, :20] = 255
    return pixels


def write_video(path, frames=12, fourcc="mp4v", size=(WIDTH, HEIGHT), first=0):
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*fourcc), RATE_HZ, size)
    assert writer.isOpened()
    for number in range(first, first + frames):
        writer.write(picture(number, *size))
    writer.release()
    return path


def write_with_gaps(path, frames=12):
    """A Matroska file in which the camera dropped two of three frames."""
    options = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), RATE_HZ, (WIDTH, HEIGHT), options
    )
    assert writer.isOpened()
    for number in range(frames):
        writer.set(cv2.VIDEOWRITER_PROP_PTS, 3 * number)
        writer.write(cv2.imencode(".jpg", picture(number))[1].reshape(1, -1))
    writer.release()
    return path


def frame_of(bgr):
    """The number of a decoded picture."""
    return round((int((bgr[-30, :, 1] > 120).sum()) - 6) / 6)


def boxes(data, start, end):
    """(name, position, size) of the boxes of an MP4, those inside others too."""
    while start + 8 <= end:
        size, name = struct.unpack_from(">I4s", data, start)
        yield name, start, size
        if name in BOXES:
            yield from boxes(data, start + 8, start + size)
        start += size


def with_times(path, times_ms):
    """Give an MP4 of ``write_video`` other times: a table of durations (stts), without the list of edits (edts)."""
    data = path.read_bytes().replace(b"edts", b"free")
    found = {name: (at, size) for name, at, size in boxes(data, 0, len(data))}
    scale_at = found[b"mdhd"][0] + 20
    per_ms = struct.unpack_from(">I", data, scale_at)[0] / 1000
    ticks = [
        round(later * per_ms) - round(earlier * per_ms) for earlier, later in pairwise((*times_ms, times_ms[-1] + 50))
    ]
    at, size = found[b"stts"]
    table = struct.pack(">4sII", b"stts", 0, len(ticks)) + b"".join(struct.pack(">II", 1, t) for t in ticks)
    longer = 4 + len(table) - size
    changed = bytearray(data[:at] + struct.pack(">I", 4 + len(table)) + table + data[at + size :])
    for name in BOXES:
        start, length = found[name]
        struct.pack_into(">I", changed, start, length + longer)
    path.write_bytes(changed)
    return path


def turned(path):
    """Make an MP4 one that is shown after a quarter turn clockwise."""
    data = bytearray(path.read_bytes())
    struct.pack_into(">9i", data, data.find(b"tkhd") + 44, *QUARTER_TURN)
    path.write_bytes(data)
    return path
