"""Encodes and decodes images.

OpenCV is imported at the first decoded image. Pillow is imported only for WebP and for what OpenCV cannot read: its
import takes as long as a frame, so the sizes of PNG and JPEG are read here.
Both get only PNG, JPEG and WebP: these have one size in the header, and some of Pillow's other readers start a program.
"""

import io
import os
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import png
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Ids, Image
from roadperc_stream.model.tag_tables import Colour

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

PNG_MAGIC: Final = png.MAGIC
_FORMATS: Final[Mapping[str, bytes]] = {
    "PNG": re.escape(PNG_MAGIC),
    "JPEG": rb"\xff\xd8\xff",
    "WEBP": rb"RIFF....WEBP",
    "BMP": rb"BM",
    "GIF": rb"GIF8[79]a",
    "TIFF": rb"II[*+]\0|MM\0[*+]",
}
"""The first bytes of common formats. Readable formats have Pillow's names."""
_READ: Final = ("PNG", "JPEG", "WEBP")
_VIDEOS: Final = {"h264": r"h\.?264|avc", "h265": r"h\.?265|hevc", "av1": "av0?1", "vp9": "vp0?9", "vp8": "vp0?8"}
"""Names of video in the format of a message, by codec."""
_PNG_SIZE: Final = struct.Struct(">16xII")
"""Columns and rows in the header."""
_JPEG_FRAME: Final = struct.Struct(">BBHBHH")
"""A frame header: marker, length, bits, rows, columns."""
_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE: Final = frozenset((0x00, 0x01, *range(0xD0, 0xD9)))
"""Markers without a length."""
_PALETTE_ENTRIES: Final = 256
_PNG_READERS: Final[Mapping[str, Callable[[bytes], NDArray[Any] | None]]] = {
    "IMREAD_COLOR": png.bgr,
    "IMREAD_GRAYSCALE": png.grey,
    "IMREAD_UNCHANGED": png.grey16,
}
"""The PNG reader that replaces each OpenCV mode, for the PNGs it supports."""
UNKNOWN_MM: Final = 0
DEPTH_LIMIT_MM: Final = 65535
_ROWS_AT_ONCE: Final = 32
"""Rows of a depth image that fit into the processor's cache."""
_LAST_UPRIGHT: Final = 4
"""Larger EXIF orientations swap rows and columns."""


def decode_bgr(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> Image:
    """(H, W, 3) uint8 of an encoded image.

    Raises:
        DecodeError: OpenCV cannot read the image, or its header exceeds the limits.
    """
    return np.asarray(_pixels(data, "IMREAD_COLOR", limits), np.uint8)


def decode_grey(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> Image:
    """(H, W) uint8 of an encoded image; a JPEG's colours are not decoded.

    Raises:
        DecodeError: OpenCV cannot read the image, or its header exceeds the limits.
    """
    return np.asarray(_pixels(data, "IMREAD_GRAYSCALE", limits), np.uint8)


def decode_grey16(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> NDArray[np.uint16]:
    """(H, W) uint16 of a grey PNG with 16 bits a pixel.

    Raises:
        DecodeError: it is another image, or its header exceeds the limits.
    """
    pixels = _pixels(data, "IMREAD_UNCHANGED", limits, ("PNG",))
    if pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise DecodeError(f"{len(data)} bytes are not a PNG with one number of 16 bits a pixel")
    return pixels


def require_pixels(what: str, width: int, height: int, limits: LimitsConfig) -> None:
    """Check a size against the limits, before memory is allocated.

    Raises:
        DecodeError: the message names the limit.
    """
    if width * height > limits.image_pixels:
        expected = f"expected limits.image_megapixels {limits.image_megapixels:g} at most"
        raise DecodeError(f"{what} of {width}x{height}, {width * height / 1e6:.0f} megapixels: {expected}")


def format_of(data: bytes) -> str:
    """Name of an image's format by its first bytes; empty if unknown."""
    return next((name for name, magic in _FORMATS.items() if re.match(magic, data, re.DOTALL)), "")


def video_codec(layout: str) -> str:
    """The codec that the ``format`` of an image message names; empty for images."""
    return next((codec for codec, names in _VIDEOS.items() if re.search(names, layout, re.IGNORECASE)), "")


def image_size(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> tuple[int, int]:
    """Columns and rows of an encoded image by its header, in OpenCV's orientation.

    Raises:
        DecodeError: not an image, or its size exceeds the limits.
    """
    from PIL import ExifTags

    with _opened(data, limits) as image:
        orientation = image.getexif().get(ExifTags.Base.Orientation, 1) if "exif" in image.info else 1
        return (image.height, image.width) if orientation > _LAST_UPRIGHT else (image.width, image.height)


def _format_among(formats: tuple[str, ...], data: bytes) -> str:
    """Name of an image's format.

    Raises:
        DecodeError: not an image of one of the formats.
    """
    name = format_of(data)
    if not name:
        raise DecodeError(f"{len(data)} bytes are not an image" + f", they start with {data[:4].hex()}" * bool(data))
    if name not in formats:
        raise DecodeError(f"image of format {name}: expected {', '.join(formats).lower()}; convert it")
    return name


@contextmanager
def _opened(data: bytes, limits: LimitsConfig, formats: tuple[str, ...] = _READ) -> Iterator["PillowImage"]:
    """An image file whose header was checked against the limits.

    Raises:
        DecodeError: not an image of one of the formats, or its size exceeds the limits.
    """
    from PIL import Image as Pillow
    from PIL import UnidentifiedImageError

    name = _format_among(formats, data)
    Pillow.MAX_IMAGE_PIXELS = None  # the limits replace it
    try:
        with Pillow.open(io.BytesIO(data), formats=(name,)) as image:
            require_pixels("image", image.width, image.height, limits)
            yield image
    except UnidentifiedImageError as error:
        raise DecodeError(f"{len(data)} bytes are not a valid {name}, they start with {data[:4].hex()}") from error
    except (OSError, ValueError, RuntimeError, SyntaxError, struct.error) as error:
        raise DecodeError(f"{len(data)} bytes are not a complete {name}: {error}") from error


def _require_within(data: bytes, limits: LimitsConfig, formats: tuple[str, ...]) -> None:
    """Check format and size against the limits.

    Raises:
        DecodeError: not an image of one of the formats, or its size exceeds the limits.
    """
    name = _format_among(formats, data)
    if name == "PNG" and len(data) >= _PNG_SIZE.size:
        width, height = _PNG_SIZE.unpack_from(data)
        require_pixels("image", width, height, limits)
    elif name == "JPEG":
        require_pixels("image", *_jpeg_size(data), limits)
    else:
        with _opened(data, limits):
            pass


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Columns and rows in the first frame header (SOF, ITU T.81 B.2.2).

    Raises:
        DecodeError: no frame header.
    """
    at = 2
    while (at := data.find(b"\xff", at)) >= 0 and at + _JPEG_FRAME.size <= len(data):
        _, marker, length, _, height, width = _JPEG_FRAME.unpack_from(data, at)
        if marker in _JPEG_FRAMES:
            return width, height
        at += 1 if marker == 0xFF else 2 if marker in _JPEG_BARE else 2 + length
    raise DecodeError(f"{len(data)} bytes are not a complete JPEG: no size in it")


def _pixels(data: bytes, mode: str, limits: LimitsConfig, formats: tuple[str, ...] = _READ) -> NDArray[Any]:
    """Pixels in OpenCV's ``mode``.

    Raises:
        DecodeError: OpenCV cannot read them, with Pillow's reason; or the header exceeds the limits.
    """
    import cv2

    _require_within(data, limits, formats)
    pixels = _PNG_READERS[mode](data)
    if pixels is None:
        with suppress(cv2.error):
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), getattr(cv2, mode))
    if pixels is None:
        with _opened(data, limits, formats) as image:
            image.load()
        raise DecodeError(f"{len(data)} bytes are not an image that OpenCV can read")
    return pixels


def decode_indices(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> Image:
    """(H, W) uint8 indices of a palette PNG, or the grey values of a grey one.

    Raises:
        DecodeError: not an image, no indices, or the header exceeds the limits.
    """
    # Only PNG: the grey values of a JPEG are not tags.
    _require_within(data, limits, ("PNG",))
    tags = png.indices(data)
    if tags is not None:
        return tags
    with _opened(data, limits, ("PNG",)) as image:
        if image.mode not in ("P", "L"):
            raise DecodeError(f"image of mode {image.mode}: expected palette indices (P) or grey tags (L)")
        return np.array(image)


def value_counts(pixels: Image) -> NDArray[np.int64]:
    """(256,) number of (H, W) pixels of each value; ``np.bincount`` takes five times as long."""
    import cv2

    return cv2.calcHist([pixels], [0], None, [256], [0, 256]).ravel().astype(np.int64)


def instance_ids(bgr: Image) -> Ids:
    """(H, W) instance ids in CARLA's coding: green is the low byte, blue the high byte. Red, the tag, is not used.

    Source: CARLA's documentation, "Instance segmentation camera".
    """
    import cv2

    low_high = np.empty((*bgr.shape[:2], 2), np.uint8)
    cv2.mixChannels([bgr], [low_high], [1, 0, 0, 1])  # from channel 1 to 0, from 0 to 1
    return low_high.view("<u2")[..., 0].astype(np.uint16, copy=False)


def encode_indices(indices: Image, colours: tuple[Colour, ...]) -> bytes:
    """Palette PNG of (H, W) uint8 indices, so that every viewer shows the colours of the labels."""
    from PIL import Image as Pillow

    image = Pillow.fromarray(indices, "L").convert("L")
    image.putpalette(np.array(colours, np.uint8).tobytes().ljust(3 * _PALETTE_ENTRIES, b"\x00"))
    stream = io.BytesIO()
    image.save(stream, "PNG", compress_level=3)
    return stream.getvalue()


def encode_jpeg(pixels_bgr: Image, quality: int) -> bytes:
    """JPEG of (H, W, 3) pixels."""
    import cv2

    _, encoded = cv2.imencode(".jpg", pixels_bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return encoded.tobytes()


def encode_png(pixels: Image) -> bytes:
    """PNG of (H, W, 3) pixels, or (H, W) grey ones."""
    import cv2

    return cv2.imencode(".png", pixels)[1].tobytes()


def depth_from_mm(depth_mm: NDArray[np.uint16]) -> Float32:
    """(H, W) metres of 16-bit millimetres: NaN for 0; 65535 means 65.535 m or more."""
    depth_m = depth_mm.astype(np.float32)
    depth_m *= np.float32(0.001)
    np.copyto(depth_m, np.float32(np.nan), where=depth_mm == UNKNOWN_MM)
    return depth_m


def depth_to_mm(depth_m: Float32) -> NDArray[np.uint16]:
    """(H, W) 16-bit millimetres: 0 for unknown depth (NaN, not positive), 65535 for depth beyond the range."""
    depth_mm = np.empty(depth_m.shape, np.uint16)
    for top in range(0, len(depth_m), _ROWS_AT_ONCE):
        rows = slice(top, top + _ROWS_AT_ONCE)
        known = depth_m[rows] > 0
        with np.errstate(over="ignore", invalid="ignore"):  # overflow is beyond the range; NaN is unknown
            millimetres = depth_m[rows] * np.float32(1000.0)
            np.clip(millimetres, UNKNOWN_MM, DEPTH_LIMIT_MM, out=millimetres)
            whole = np.rint(millimetres, out=millimetres).astype(np.uint16)
        np.maximum(whole * known, known, out=depth_mm[rows])
    return depth_mm


@contextmanager
def quiet_opencv() -> Iterator[None]:
    """Silence the messages of OpenCV and FFmpeg about videos that cannot be read or written."""
    import cv2

    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)
