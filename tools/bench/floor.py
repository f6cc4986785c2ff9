"""The floor: the time of the library calls that no replay of a log can avoid.

They are decompression, decoding of pixels, corners with optical flow, Hough lines, disparities, and serialisation of
the results. The OpenCV calls are timed inside the chain. The other calls run once per frame on the messages and results
of the same replay. Preparation of a call does not count.
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
"""OpenCV functions by the part of the floor."""


def inflate_chunks(log: Path, times: Times) -> None:
    """Decompress a log's chunks."""
    with log.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk) and record.compression == "zstd":
                with times("inflate"):
                    zstandard.ZstdDecompressor().decompress(record.data, record.uncompressed_size)


def decode_images(log: Path, times: Times) -> None:
    """Decode a log's images (camera images as grey) with a library and with this project; count the faster one."""
    project, library = Times(), Times()
    with log.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(topics=(*_IMAGES, _TAGS)):
            content = bytes(CompressedImage.FromString(message.data).data)
            with project("decode"):
                (images.decode_indices if channel.topic == _TAGS else images.decode_grey)(content)
            with library("decode"):
                if channel.topic == _TAGS:
                    np.array(PillowImage.open(io.BytesIO(content), formats=("PNG",)))
                else:
                    cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    times.ms["decode"] = min(project.ms["decode"], library.ms["decode"])


def perceive(log: Path, times: Times) -> int:
    """Run the chain over a log, time its OpenCV calls (corners, lines, disparities); return the number of frames."""
    create = cv2.StereoSGBM.create

    def matcher(**settings: Any) -> SimpleNamespace:
        return SimpleNamespace(compute=times("disparity")(create(**settings).compute))

    calls: dict[str, Any] = {name: times(part)(getattr(cv2, name)) for name, part in _CALLS.items()}
    with patch.multiple(cv2, StereoSGBM=SimpleNamespace(create=matcher), **calls):
        return sum(1 for _ in frames(log))


def serialise(result: Path, times: Times) -> None:
    """Serialise the results of a replay again, encode the drivable surface, and compress everything."""
    chunk = bytearray()
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
            chunk += message.data
            if len(chunk) > _CHUNK_BYTES:
                _compress(chunk, times)
                chunk.clear()
    _compress(chunk, times)


def _compress(chunk: bytearray, times: Times) -> None:
    with times("serialise"):
        zstandard.ZstdCompressor(level=1).compress(chunk)


def measure(log: str | Path, result: str | Path) -> dict[str, float]:
    """Return the CPU time in ms per frame of a log and its result: ``cpu`` in total, and of each part."""
    times = Times()
    with one_thread():
        inflate_chunks(Path(log), times)
        decode_images(Path(log), times)
        count = perceive(Path(log), times)
        serialise(Path(result), times)
    together = {"cpu": sum(times.ms.values())} | {f"part/{part}": ms for part, ms in times.ms.items()}
    return {name: value / count for name, value in together.items()}
