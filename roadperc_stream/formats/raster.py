"""Decodes the raw pixels of sensor_msgs/msg/Image and foxglove.RawImage, and CARLA's class colours.

Both messages use the names in ``sensor_msgs/image_encodings.hpp``. A row has ``step`` bytes and may end with padding.
A colour of CARLA's CityScapesPalette means the same class in every version.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Ids, Image
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14, TagTable

PALETTE_TABLE: Final = CARLA_FROM_0_9_14
"""Table for colours in a log without a tag table. It has all earlier classes (a vehicle is a car)."""
UNKNOWN: Final = 255
"""In ``tags_by_code``: a colour without a class."""
_ENCODINGS: Final[Mapping[str, tuple[str, int, str | None]]] = {
    "bgr8": ("u1", 3, ""),
    "8UC3": ("u1", 3, ""),
    "bgr16": ("u2", 3, ""),
    "rgb8": ("u1", 3, "RGB2BGR"),
    "rgb16": ("u2", 3, "RGB2BGR"),
    "bgra8": ("u1", 4, "BGRA2BGR"),
    "8UC4": ("u1", 4, "BGRA2BGR"),
    "bgra16": ("u2", 4, "BGRA2BGR"),
    "rgba8": ("u1", 4, "RGBA2BGR"),
    "rgba16": ("u2", 4, "RGBA2BGR"),
    "mono8": ("u1", 1, "GRAY2BGR"),
    "8UC1": ("u1", 1, "GRAY2BGR"),
    "mono16": ("u2", 1, "GRAY2BGR"),
    "16UC1": ("u2", 1, None),
    "32FC1": ("f4", 1, None),
    **{
        f"bayer_{tiles.lower()}{8 * size}": (f"u{size}", 1, f"Bayer{tiles}2BGR")
        for tiles in ("RGGB", "BGGR", "GBRG", "GRBG")
        for size in (1, 2)
    },
    **dict.fromkeys(("yuv422", "uyvy"), ("u1", 2, "YUV2BGR_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), ("u1", 2, "YUV2BGR_YUY2")),
    "nv12": ("u1", 1, "YUV2BGR_NV12"),
    "nv21": ("u1", 1, "YUV2BGR_NV21"),
}
"""numpy type of a number, numbers a pixel, and OpenCV's conversion to BGR: empty for BGR, None if no camera image."""
_PLANES: Final = ("nv12", "nv21")
"""Half as many rows of colours follow the rows of brightness."""
_TAGS: Final = ("mono8", "8UC1", "mono16", "16UC1")
_DEPTHS: Final = ("16UC1", "mono16", "32FC1")
_LARGEST_TAG: Final = 255


@cache
def tags_by_code(table: TagTable) -> Image:
    """(2^24,) uint8 tag of every colour, red * 65536 + green * 256 + blue."""
    tags = np.full(1 << 24, UNKNOWN, np.uint8)
    for (r, g, b), tag in table.tag_by_colour.items():
        tags[(r << 16) | (g << 8) | b] = tag
    return tags


def tags_of_colours(bgr: Image, table: TagTable) -> Image:
    """(H, W) uint8 tags of an (H, W, 3) image of class colours.

    Raises:
        DecodeError: a colour has no class; the message names the most frequent such colour.
    """
    import cv2

    codes = cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA).view("<u4")[..., 0] & 0xFFFFFF
    tags: Image = tags_by_code(table)[codes]
    if (tags == UNKNOWN).any():
        raise DecodeError(_unknown_in_words(codes[tags == UNKNOWN], table))
    return tags


def _unknown_in_words(codes: NDArray[Any], table: TagTable) -> str:
    distinct, counts = np.unique(codes, return_counts=True)
    code = int(distinct[counts.argmax()])
    colour = (code >> 16, code >> 8 & 255, code & 255)
    more = f" and {len(distinct) - 1} more colours" if len(distinct) > 1 else ""
    return f"colour {colour} ({counts.max()} pixels){more} is no class's of {table.name}: expected CARLA's palette"


@dataclass(frozen=True)
class Raster:
    """The pixels of an image message, in their encoding."""

    encoding: str
    width: int
    height: int
    step: int
    data: bytes | NDArray[np.uint8]
    big_endian: bool = False

    @classmethod
    def of(cls, message: Any) -> "Raster":
        """Pixels of a foxglove.RawImage, or of a sensor_msgs/msg/Image, little-endian or big-endian."""
        size = int(message.width), int(message.height), int(message.step)
        data = message.data if isinstance(message.data, bytes) else np.asarray(message.data, np.uint8)
        return cls(str(message.encoding), *size, data, bool(getattr(message, "is_bigendian", False)))

    def pixels(self) -> NDArray[Any]:
        """(H, W) or (H, W, channels) numbers, (3 H / 2, W) of nv12; a view of ``data`` if rows are not padded.

        Raises:
            DecodeError: an unknown encoding, or too few bytes for the size.
        """
        if self.encoding not in _ENCODINGS:
            raise DecodeError(f"image encoding {self.encoding!r}: expected one of {', '.join(_ENCODINGS)}")
        kind, channels, _ = _ENCODINGS[self.encoding]
        dtype = np.dtype(kind).newbyteorder(">" if self.big_endian else "<")
        used, found = dtype.itemsize * channels * self.width, len(self.data)
        height = self.height * 3 // 2 if self.encoding in _PLANES else self.height
        if not (self.width and self.height) or self.step < used or found < self.step * height:
            size = f"{self.encoding!r} image {self.width}x{self.height} with step {self.step}"
            raise DecodeError(f"{size}: expected {max(self.step, used) * height} bytes or more, found {found}")
        rows = np.frombuffer(self.data, np.uint8, self.step * height).reshape(height, self.step)
        shape = (height, self.width) + (channels,) * (channels > 1)
        return np.ascontiguousarray(rows[:, :used]).view(dtype).reshape(shape)

    def size(self) -> tuple[int, int]:
        """Columns and rows.

        Raises:
            DecodeError: as ``pixels``.
        """
        self.pixels()
        return self.width, self.height

    def bgr(self) -> Image:
        """(H, W, 3) uint8, also of a grey image.

        Raises:
            DecodeError: the encoding is not one of a camera image.
        """
        *_, conversion = _ENCODINGS.get(self.encoding, ("",))
        if conversion is None:
            raise DecodeError(f"image encoding {self.encoding!r}: expected colours, mono8 or mono16")
        pixels = self._eight_bits()  # of an encoding that is known
        if not conversion:
            return pixels
        import cv2

        try:
            return cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}")).astype(np.uint8, copy=False)
        except cv2.error as error:
            size = f"{self.encoding!r} image {self.width}x{self.height}"
            raise DecodeError(f"{size}: expected an even number of columns and rows") from error

    def grey(self) -> Image:
        """(H, W) uint8.

        Raises:
            DecodeError: the encoding is not one of a camera image.
        """
        if self.encoding in ("mono8", "8UC1", "mono16"):
            return self._eight_bits()
        import cv2

        return cv2.cvtColor(self.bgr(), cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)

    def depth(self) -> tuple[Float32, float]:
        """(H, W) float32 metres, NaN unknown, and the largest depth of the encoding.

        Raises:
            DecodeError: the encoding is not one of depth.
        """
        if self.encoding not in _DEPTHS:
            raise DecodeError(f"depth of encoding {self.encoding!r}: expected one of {', '.join(_DEPTHS)}")
        pixels = self.pixels()
        if pixels.dtype.kind == "u":
            return images.depth_from_mm(pixels), images.DEPTH_LIMIT_MM / 1000
        depth_m = pixels.astype(np.float32)
        depth_m[~(depth_m > 0)] = np.nan
        return depth_m, np.inf

    @property
    def indexed(self) -> bool:
        """Whether a pixel is one number: in a segmentation a tag, not a colour."""
        return self.encoding in _TAGS

    def tags(self, table: TagTable) -> Image:
        """(H, W) uint8 tags: the pixels themselves, also of 16 bits, or the classes of CARLA's colours.

        Raises:
            DecodeError: not tags, a tag above 255, or a colour without a class.
        """
        if not self.indexed:
            return tags_of_colours(self.bgr(), table)
        pixels = self.pixels()
        if pixels.dtype.itemsize > 1 and (largest := int(pixels.max())) > _LARGEST_TAG:
            raise DecodeError(f"tags of encoding {self.encoding!r} up to {largest}: expected 0 to {_LARGEST_TAG}")
        return pixels.astype(np.uint8, copy=False)

    def ids(self) -> Ids:
        """(H, W) uint16 instance ids: the pixels themselves, or CARLA's coding in colours.

        Raises:
            DecodeError: not instance masks.
        """
        return self.pixels().astype(np.uint16) if self.indexed else images.instance_ids(self.bgr())

    def _eight_bits(self) -> Image:
        """``pixels``; of 16 bits the upper 8."""
        pixels: Image = self.pixels()
        return (pixels >> 8).astype(np.uint8) if pixels.dtype.itemsize > 1 else pixels
