"""What no replay of a log can do without, by calls of the libraries alone: the floor its time is compared with.

Inflating what is compressed, decoding pixels, corners with optical flow and perspective from n points, Hough's lines,
disparities, and serialising the results. Each is called once a frame with the arguments and image sizes that the chain
has, on the frames and results of the same replay; what prepares a call is not counted.

Run by the bench as ``python -m roadperc_stream.tools.bench.floor LOG.mcap RESULT.mcap OUT.json``.
"""

import argparse
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import zstandard
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from PIL import Image as PillowImage

from roadperc_stream.api import frames
from roadperc_stream.chain.stages.lanes.lines import propose
from roadperc_stream.chain.stages.stereo import disparities_needed, matcher_of
from roadperc_stream.config import LanesConfig, ReplayConfig, StereoConfig
from roadperc_stream.formats import images
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES
from roadperc_stream.schemas.topics import DRIVABLE_TOPIC, RESULT_PREFIX
from roadperc_stream.system.threads import one_thread

from .course import ROAD_LINE, SIDEWALK, Times
from .course_log import FRONT, RIGHT, Array, decode, intrinsics, read_messages
from .tracking_floor import Tracking

_CHUNK_BYTES: Final = 1 << 20
_IMAGES: Final = (f"{FRONT}/image", f"{RIGHT}/image")
_TAGS: Final = f"{FRONT}/segmentation"


def inflate_chunks(log: Path, times: Times) -> None:
    """Decompress a log's chunks."""
    with log.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk) and record.compression == "zstd":
                with times("inflate"):
                    zstandard.ZstdDecompressor().decompress(record.data, record.uncompressed_size)


def decode_images(log: Path, times: Times) -> None:
    """Decode a log's images, the camera's in grey, by the faster of two ways: a library, or this project."""
    ours, theirs = Times(), Times()
    for topic, data in messages_of(log, (*_IMAGES, _TAGS)):
        content = bytes(CompressedImage.FromString(data).data)
        with ours("decode"):
            (images.decode_indices if topic == _TAGS else images.decode_grey)(content)
        with theirs("decode"):
            if topic == _TAGS:
                np.array(PillowImage.open(io.BytesIO(content), formats=("PNG",)))
            else:
                cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    times.ms["decode"] = min(ours.ms["decode"], theirs.ms["decode"])


def messages_of(log: Path, topics: tuple[str, ...]) -> Iterator[tuple[str, bytes]]:
    """Topic and bytes of a log's messages."""
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(topics=topics):
            yield channel.topic, message.data


def perceive(log: Path, cfg: ReplayConfig, times: Times) -> int:
    """Track, propose lines and match the pair's images in all frames of a log.

    Returns:
        The number of frames.
    """
    tracking, disparities, count = None, disparities_of(log), 0
    for messages in read_messages(log):
        tracking = Tracking(cfg.odometry, intrinsics(messages), times) if tracking is None else tracking
        frame = decode(messages)
        grey = cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY)
        tracking.step(grey, frame.depth_m)
        propose_lines(cfg.lanes, frame.tags, times)
        if frame.right is not None:
            match_pair(cfg.stereo, disparities, grey, cv2.cvtColor(frame.right, cv2.COLOR_BGR2GRAY), times)
        count += 1
    return count


def propose_lines(cfg: LanesConfig, tags: Array, times: Times) -> None:
    """Hough lines of the separators' edges."""
    mask = np.isin(tags, (ROAD_LINE, SIDEWALK)).astype(np.uint8) * 255
    edges = cv2.Canny(cv2.medianBlur(mask, 5), cfg.canny_low, cfg.canny_high)
    with times("hough"):
        propose(cfg, np.asarray(edges, np.uint8))


def disparities_of(log: Path) -> int:
    """How many disparities the chain tries in a log's pairs, pixels of the image; 0 without a pair."""
    frame = next(frames(log, max_frames=1)).input
    if frame.right_camera is None or frame.right_camera.baseline_m is None:
        return 0
    return disparities_needed(frame.left_camera, frame.right_camera.baseline_m, frame.ego_T_left) or 0


def match_pair(cfg: StereoConfig, disparities: int, left: Array, right: Array, times: Times) -> None:
    """Disparities at half resolution, as ``fast`` has them, with columns beside the image for those near its edge."""
    count = -(-disparities // 32) * 16
    matcher = matcher_of(cfg, count)
    halves = [cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in (left, right)]
    wide = [cv2.copyMakeBorder(half, 0, 0, count, 0, cv2.BORDER_REPLICATE) for half in halves]
    with times("disparity"):
        matcher.compute(*wide)


def serialise(result: Path, times: Times) -> None:
    """Serialise the results again that a replay wrote, pack the drivable surface and compress all of them."""
    waiting = bytearray()
    with result.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if not channel.topic.startswith(RESULT_PREFIX):
                continue
            if schema is not None and schema.name in MESSAGE_TYPES:
                content = MESSAGE_TYPES[schema.name].FromString(message.data)
                with times("serialise"):
                    content.SerializeToString()
            if channel.topic == DRIVABLE_TOPIC:
                png = np.frombuffer(CompressedImage.FromString(message.data).data, np.uint8)
                mask = np.asarray(cv2.imdecode(png, cv2.IMREAD_GRAYSCALE))
                with times("serialise"):
                    cv2.imencode(".png", mask, [cv2.IMWRITE_PNG_BILEVEL, 1])
            waiting += message.data
            if len(waiting) > _CHUNK_BYTES:
                _compress(waiting, times)
                waiting.clear()
    _compress(waiting, times)


def _compress(chunk: bytearray, times: Times) -> None:
    with times("serialise"):
        zstandard.ZstdCompressor(level=1).compress(chunk)


def measure(log: Path, result: Path) -> dict[str, float]:
    """Milliseconds of a processor a frame: ``cpu`` together, and of each part."""
    times = Times()
    inflate_chunks(log, times)
    decode_images(log, times)
    count = perceive(log, ReplayConfig(), times)
    serialise(result, times)
    together = {"cpu": sum(times.ms.values())} | {f"part/{part}": ms for part, ms in times.ms.items()}
    return {name: value / count for name, value in together.items()}


def main(argv: list[str] | None = None) -> None:
    """Measure, and write what came of it."""
    parser = argparse.ArgumentParser(description="what no replay of a log can do without")
    for name in ("log", "result", "out"):
        parser.add_argument(name, type=Path)
    arguments = parser.parse_args(argv)
    with one_thread():
        measured = measure(arguments.log, arguments.result)
    arguments.out.write_text(json.dumps(measured))


if __name__ == "__main__":
    main()
