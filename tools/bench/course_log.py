"""What the course's method sees of a rendered log, read with the mcap library and decoded with OpenCV alone."""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.reader import make_reader
from numpy.typing import NDArray
from PIL import Image as PillowImage

from roadperc_stream.schemas.roadperc_pb2 import Box, Detections

Array = NDArray[Any]
FRONT: Final = "/camera/front"
RIGHT: Final = "/camera/right"


@dataclass(frozen=True)
class CourseFrame:
    """Decoded images of a frame: colour, metres, tags, boxes; of a pair's right camera too."""

    image: Array
    depth_m: Array
    tags: Array
    detections: list[tuple[str, tuple[int, int, int, int]]]
    right: Array | None


def read_messages(path: Path) -> Iterator[dict[str, bytes]]:
    """The messages of each frame by topic; the first one has the calibration as well."""
    with path.open("rb") as stream:
        of_frame: dict[str, bytes] = {}
        stamp = None
        for _, channel, message in make_reader(stream).iter_messages():
            if stamp is not None and message.log_time != stamp and f"{FRONT}/image" in of_frame:
                yield of_frame
                of_frame = {}
            stamp = message.log_time
            of_frame[channel.topic] = message.data
        if f"{FRONT}/image" in of_frame:
            yield of_frame


def intrinsics(messages: dict[str, bytes]) -> Array:
    """(3, 3) K of the front camera."""
    return np.array(CameraCalibration.FromString(messages[f"{FRONT}/calibration"]).K).reshape(3, 3)


def decode(messages: dict[str, bytes]) -> CourseFrame:
    """Pixels of a frame's messages."""
    image = _colour(messages[f"{FRONT}/image"])
    height, width = image.shape[:2]
    # The pixels of a raw ROS image are its last bytes.
    depth_mm = np.frombuffer(messages[f"{FRONT}/depth"][-2 * height * width :], np.uint16).reshape(height, width)
    segmentation = _content(messages[f"{FRONT}/segmentation"])
    tags = np.array(PillowImage.open(io.BytesIO(segmentation), formats=("PNG",)))
    found = Detections.FromString(messages[f"{FRONT}/detections"]).detections
    boxes = [(item.label, _corners(item.box_px)) for item in found]
    right = _colour(messages[f"{RIGHT}/image"]) if f"{RIGHT}/image" in messages else None
    return CourseFrame(image, depth_mm / 1000.0, tags, boxes, right)


def _corners(box: Box) -> tuple[int, int, int, int]:
    return round(box.x_min), round(box.y_min), round(box.x_max), round(box.y_max)


def _content(message: bytes) -> bytes:
    return bytes(CompressedImage.FromString(message).data)


def _colour(message: bytes) -> Array:
    return np.asarray(cv2.imdecode(np.frombuffer(_content(message), np.uint8), cv2.IMREAD_COLOR))
