"""What the messages of a log contain. Images and points are decoded when they are first used."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from math import floor

import numpy as np

from roadperc_stream.geometry import Float, Float32
from roadperc_stream.geometry.arrays import Ids, Image, read_only
from roadperc_stream.model.tag_tables import TagTable


@dataclass(frozen=True)
class CameraImage:
    """An image that is decoded when its pixels are first used."""

    frame_id: str
    decode_bgr: Callable[[], Image] = field(repr=False)
    decode_grey: Callable[[], Image] = field(repr=False)
    read_size: Callable[[], tuple[int, int]] | None = field(default=None, repr=False)
    """Reads columns and rows without decoding; None if the format does not allow it."""
    lossless: bool = True
    """Whether the message stores the pixels themselves: raw, or as a PNG."""
    coding: str = ""
    """Format of the file, such as ``png``, or encoding of raw pixels, such as ``rgb8``; empty if unknown."""
    encoded: bytes = field(default=b"", repr=False)
    """The image file of the message; empty if the pixels are raw or rectified."""

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows.

        Raises:
            DecodeError: the bytes are not an image.
        """
        return self.read_size() if self.read_size else (self.grey.shape[1], self.grey.shape[0])

    @cached_property
    def grey(self) -> Image:
        """(H, W) uint8.

        Raises:
            DecodeError: the bytes are not an image.
        """
        return read_only(self.decode_grey(), np.uint8, (None, None), "image")

    @cached_property
    def bgr(self) -> Image:
        """(H, W, 3) uint8.

        Raises:
            DecodeError: the bytes are not an image.
        """
        return read_only(self.decode_bgr(), np.uint8, (None, None, 3), "image")


@dataclass(frozen=True)
class VideoFrame:
    """A frame of a video, or an image; ``format`` is its codec."""

    frame_id: str
    format: str
    data: bytes


@dataclass(frozen=True)
class DepthImage:
    """Depth along the camera's z axis, decoded when first used."""

    frame_id: str
    decode_depth: Callable[[], tuple[Float32, float]] = field(repr=False)
    read_size: Callable[[], tuple[int, int]] | None = field(default=None, repr=False)
    """As in ``CameraImage``."""
    coding: str = ""

    @cached_property
    def _decoded(self) -> tuple[Float32, float]:
        depth_m, limit_m = self.decode_depth()
        return read_only(depth_m, np.float32, (None, None), "depth"), limit_m

    @property
    def depth_m(self) -> Float32:
        """(H, W) float32 metres, NaN unknown, ``limit_m`` at or beyond the end of the encoding's range.

        Raises:
            DecodeError: the message cannot be decoded.
        """
        return self._decoded[0]

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows.

        Raises:
            DecodeError: as ``depth_m``.
        """
        return self.read_size() if self.read_size else (self.depth_m.shape[1], self.depth_m.shape[0])

    @property
    def limit_m(self) -> float:
        """Depth at which the encoding saturates, metres; such a pixel is at least this far."""
        return self._decoded[1]


@dataclass(frozen=True)
class PointCloud:
    """A lidar's points, decoded when first used."""

    frame_id: str
    decode_points: Callable[[], Float32] = field(repr=False)
    """Returns all points, including those that are not finite."""

    @cached_property
    def points_m(self) -> Float32:
        """(N, 3) float32 metres in the frame ``frame_id``, without points that are not finite.

        Raises:
            DecodeError: the message cannot be decoded.
        """
        finite = np.isfinite(self._all_m).all(axis=1)
        return read_only(self._all_m if finite.all() else self._all_m[finite], np.float32, (None, 3), "points")

    @property
    def left_out(self) -> int:
        """Number of points that are not finite."""
        return len(self._all_m) - len(self.points_m)

    @cached_property
    def _all_m(self) -> Float32:
        return self.decode_points()


@dataclass(frozen=True)
class TagImage:
    """A segmentation, decoded when first used."""

    frame_id: str
    table: TagTable
    decode_tags: Callable[[], Image] = field(repr=False)
    read_size: Callable[[], tuple[int, int]] | None = field(default=None, repr=False)
    """As in ``CameraImage``."""
    coding: str = ""

    @cached_property
    def tags(self) -> Image:
        """(H, W) uint8 tags of ``table``.

        Raises:
            DecodeError: the bytes are not a tag image.
        """
        return read_only(self.decode_tags(), np.uint8, (None, None), "tags")


@dataclass(frozen=True)
class InstanceImage:
    """The objects' masks, decoded when first used."""

    frame_id: str
    decode_ids: Callable[[], Ids] = field(repr=False)

    @cached_property
    def ids(self) -> Ids:
        """(H, W) uint16 number of the object in each pixel, 0 without an object.

        Raises:
            DecodeError: the bytes are not instance masks.
        """
        return read_only(self.decode_ids(), np.uint16, (None, None), "instances")


@dataclass(frozen=True)
class Transform:
    """One edge of the transform tree: ``parent_T_child``."""

    parent: str
    child: str
    parent_T_child: Float

    def __post_init__(self) -> None:
        read_only(self.parent_T_child, np.float64, (4, 4), "parent_T_child")


@dataclass(frozen=True)
class Box:
    """Half-open box in pixels: columns x_min to x_max and rows y_min to y_max, without the maxima."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float

    def rounded(self, width: int, height: int) -> tuple[int, int, int, int]:
        """x_min, y_min, x_max, y_max as whole pixels (rounded half up) clipped to the image."""
        x0, y0 = max(floor(self.x_min + 0.5), 0), max(floor(self.y_min + 0.5), 0)
        return x0, y0, min(floor(self.x_max + 0.5), width), min(floor(self.y_max + 0.5), height)

    def meets(self, other: "Box") -> bool:
        """Whether the boxes have an area in common."""
        return min(self.x_max, other.x_max) > max(self.x_min, other.x_min) and min(self.y_max, other.y_max) > max(
            self.y_min, other.y_min
        )

    def overlap(self, other: "Box") -> float:
        """Intersection over union, 0 if the boxes do not meet."""
        width = min(self.x_max, other.x_max) - max(self.x_min, other.x_min)
        height = min(self.y_max, other.y_max) - max(self.y_min, other.y_min)
        if width <= 0 or height <= 0:
            return 0.0
        return width * height / (self.area + other.area - width * height)

    @property
    def area(self) -> float:
        """Square pixels."""
        return max(self.x_max - self.x_min, 0.0) * max(self.y_max - self.y_min, 0.0)


@dataclass(frozen=True)
class Detection:
    """One box of a detector, with its label and score.

    The score is usually 0 to 1; any finite number is allowed. ``id`` is the object's id from the detector's own
    tracker, empty without one.
    """

    label: str
    box_px: Box
    score: float
    id: str = ""
