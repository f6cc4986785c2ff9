"""What no replay of a log can do without, by calls of the libraries alone: the floor its time is compared with.

Inflating what is compressed, decoding pixels, corners with optical flow, Hough's lines, disparities, and serialising
the results. The calls of OpenCV are those of the chain itself, timed while it runs over the log's frames; the others
are made once a frame on the messages and results of the same replay. What prepares a call is not counted.
"""

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final
from unittest.mock import patch

import cv2
import numpy as np
import zstandard
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from PIL import Image as PillowImage

from roadperc_stream.api import frames
from roadperc_stream.formats import images
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES
from roadperc_stream.schemas.topics import DRIVABLE_TOPIC, RESULT_PREFIX
from roadperc_stream.system.threads import one_thread

from .course import FRONT, RIGHT, Times

_CHUNK_BYTES: Final = 1 << 20
_IMAGES: Final = (f"{FRONT}/image", f"{RIGHT}/image")
_TAGS: Final = f"{FRONT}/segmentation"
_CALLS: Final = {"cornerMinEigenVal": "track", "calcOpticalFlowPyrLK": "track", "HoughLinesP": "hough"}
"""Functions of OpenCV, and the part of the floor that each belongs to."""


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
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(topics=(*_IMAGES, _TAGS)):
            content = bytes(CompressedImage.FromString(message.data).data)
            with ours("decode"):
                (images.decode_indices if channel.topic == _TAGS else images.decode_grey)(content)
            with theirs("decode"):
                if channel.topic == _TAGS:
                    np.array(PillowImage.open(io.BytesIO(content), formats=("PNG",)))
                else:
                    cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    times.ms["decode"] = min(ours.ms["decode"], theirs.ms["decode"])


def perceive(log: Path, times: Times) -> int:
    """Run the chain over a log and time its calls of OpenCV that follow corners, find lines and match pairs.

    Returns:
        The number of frames.
    """
    create = cv2.StereoSGBM.create

    def matcher(**settings: Any) -> SimpleNamespace:
        return SimpleNamespace(compute=times("disparity")(create(**settings).compute))

    calls: dict[str, Any] = {name: times(part)(getattr(cv2, name)) for name, part in _CALLS.items()}
    with patch.multiple(cv2, StereoSGBM=SimpleNamespace(create=matcher), **calls):
        return sum(1 for _ in frames(log))


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


def measure(log: str | Path, result: str | Path) -> dict[str, float]:
    """Milliseconds of a processor a frame of a log and its replay: ``cpu`` together, and of each part."""
    times = Times()
    with one_thread():
        inflate_chunks(Path(log), times)
        decode_images(Path(log), times)
        count = perceive(Path(log), times)
        serialise(Path(result), times)
    together = {"cpu": sum(times.ms.values())} | {f"part/{part}": ms for part, ms in times.ms.items()}
    return {name: value / count for name, value in together.items()}
