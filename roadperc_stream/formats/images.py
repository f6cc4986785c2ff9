"""Pixels in and out of their encodings. OpenCV is imported with the first image that is decoded."""

import io
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, UnidentifiedImageError
from PIL import Image as PillowImage

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.core.datatypes import Image
from roadperc_stream.core.geometry import Float32
from roadperc_stream.core.semantics import Colour
from roadperc_stream.errors import DecodeError

DEPTH_LIMIT_MM: Final = 65535
UNKNOWN_MM: Final = 0
PNG_MAGIC: Final = b"\x89PNG\r\n\x1a\n"
_PNG_SIZE: Final = struct.Struct(">II")
_PNG_SIZE_AT: Final = 16
_JPEG_MAGIC: Final = b"\xff\xd8"
_JPEG_FRAME: Final = struct.Struct(">BBHBHH")
"""A frame header: marker, length, bits, rows, columns."""
_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_BARE: Final = frozenset((0x00, 0x01, *range(0xD0, 0xD9)))
"""Markers without a length."""
_PALETTE_ENTRIES: Final = 256
_LAST_UPRIGHT: Final = 4
"""EXIF orientations beyond exchange rows and columns."""


def decode_bgr(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> Image:
    """(H, W, 3) uint8 of an encoded image.

    Raises:
        DecodeError: OpenCV reads no image from the bytes, or its header claims one beyond the limits.
    """
    return _decoded(data, "IMREAD_COLOR", limits)


def decode_grey(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> Image:
    """(H, W) uint8 of an encoded image: a JPEG's colours are not even decoded.

    Raises:
        DecodeError: OpenCV reads no image from the bytes, or its header claims one beyond the limits.
    """
    return _decoded(data, "IMREAD_GRAYSCALE", limits)


def _decoded(data: bytes, mode: str, limits: LimitsConfig) -> Image:
    pixels = _pixels(data, mode, limits)
    if pixels is None:
        raise DecodeError(f"{len(data)} bytes are no image{_why(data)}")
    return pixels.astype(np.uint8, copy=False)


def decode_unchanged(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> NDArray[Any] | None:
    """Pixels as they are encoded; None of what OpenCV does not read.

    Raises:
        DecodeError: the header claims an image beyond the limits.
    """
    return _pixels(data, "IMREAD_UNCHANGED", limits)


def require_pixels(what: str, width: int, height: int, limits: LimitsConfig) -> None:
    """Refuse a size beyond the limits, before memory is given to it.

    Raises:
        DecodeError: the message names the limit.
    """
    if width * height > limits.image_pixels:
        expected = f"expected limits.image_megapixels {limits.image_megapixels:g} at most"
        raise DecodeError(f"{what} of {width}x{height}, {width * height / 1e6:.0f} megapixels: {expected}")


def image_size(data: bytes) -> tuple[int, int]:
    """Columns and rows of an encoded image by its header, as OpenCV would turn it.

    Raises:
        DecodeError: no image.
    """
    with _opened(data) as image:
        turned = image.getexif().get(ExifTags.Base.Orientation, 1) > _LAST_UPRIGHT
        return (image.height, image.width) if turned else (image.width, image.height)


@contextmanager
def _opened(data: bytes, formats: tuple[str, ...] | None = None) -> Iterator[PillowImage.Image]:
    """An image file with its header read.

    Raises:
        DecodeError: no image of these formats.
    """
    kind = formats[0] if formats else "image"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PillowImage.DecompressionBombWarning)  # the limits say what is too large
            with PillowImage.open(io.BytesIO(data), formats=formats) as image:
                yield image
    except UnidentifiedImageError as error:
        raise DecodeError(f"{len(data)} bytes are no {kind}, they start with {data[:4].hex()}") from error
    except (OSError, ValueError, SyntaxError, struct.error, PillowImage.DecompressionBombError) as error:
        raise DecodeError(f"{len(data)} bytes are no whole {kind}: {error}") from error


def _header_size(data: bytes) -> tuple[int, int]:
    """Columns and rows as they are stored. Of PNG and JPEG it is read here: Pillow takes a quarter millisecond.

    Raises:
        DecodeError: no image.
    """
    if data.startswith(PNG_MAGIC) and len(data) >= _PNG_SIZE.size + _PNG_SIZE_AT:
        width, height = _PNG_SIZE.unpack_from(data, _PNG_SIZE_AT)
        return width, height
    if data.startswith(_JPEG_MAGIC):
        return _jpeg_size(data)
    with _opened(data) as image:
        return image.width, image.height


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Of the first frame header (SOF, ITU T.81 B.2.2).

    Raises:
        DecodeError: there is none.
    """
    at = 2
    while (at := data.find(b"\xff", at)) >= 0 and at + _JPEG_FRAME.size <= len(data):
        _, marker, length, _, height, width = _JPEG_FRAME.unpack_from(data, at)
        if marker in _JPEG_FRAMES:
            return width, height
        at += 1 if marker == 0xFF else 2 if marker in _JPEG_BARE else 2 + length
    raise DecodeError(f"{len(data)} bytes are no whole JPEG: no size in it")


def _why(data: bytes) -> str:
    """What a decoder says that can say it; empty where it finds no fault."""
    try:
        with _opened(data) as image:
            image.load()
    except DecodeError as error:
        return f": {str(error).partition(': ')[2]}" if ": " in str(error) else ""
    return ""


def _pixels(data: bytes, mode: str, limits: LimitsConfig) -> NDArray[Any] | None:
    """Pixels as OpenCV's ``mode`` has them; None of what it does not read."""
    import cv2

    if not data:
        return None
    require_pixels("image", *_header_size(data), limits)
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), getattr(cv2, mode))
    except cv2.error:
        return None


def decode_indices(data: bytes, limits: LimitsConfig = DEFAULT_LIMITS) -> Image:
    """(H, W) uint8 indices of a palette PNG, or the grey values of a grey one.

    Raises:
        DecodeError: no image, one without indices, or a header that claims one beyond the limits.

    """
    if data.startswith(PNG_MAGIC):
        require_pixels("image", *_header_size(data), limits)
    # No other format: a JPEG's or GIF's greys are no tags.
    with _opened(data, ("PNG",)) as image:
        if image.mode not in ("P", "L"):
            raise DecodeError(f"image of mode {image.mode}: expected palette indices (P) or grey tags (L)")
        return np.array(image)


def encode_indices(indices: Image, colours: tuple[Colour, ...]) -> bytes:
    """Palette PNG of (H, W) uint8 indices: label images show their colours in every viewer."""
    image = PillowImage.fromarray(indices, "L").convert("L")
    image.putpalette(np.array(colours, np.uint8).tobytes().ljust(3 * _PALETTE_ENTRIES, b"\x00"))
    stream = io.BytesIO()
    image.save(stream, "PNG", compress_level=3)
    return stream.getvalue()


def encode_jpeg(pixels_bgr: Image, quality: int) -> bytes:
    """JPEG of (H, W, 3) pixels."""
    import cv2

    _, encoded = cv2.imencode(".jpg", pixels_bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return encoded.tobytes()


def depth_from_mm(depth_mm: NDArray[np.generic]) -> Float32:
    """Metres of 16-bit millimetres: NaN for 0; 65535 stands for 65.535 m or more."""
    depth_m = depth_mm.astype(np.float32)
    depth_m *= np.float32(0.001)
    depth_m[depth_mm == UNKNOWN_MM] = np.nan
    return depth_m


def depth_to_mm(depth_m: Float32) -> NDArray[np.uint16]:
    """16-bit millimetres of metres: unknown (NaN, not positive) becomes 0, what lies beyond the range 65535."""
    known = np.isfinite(depth_m) & (depth_m > 0) | (depth_m == np.inf)
    with np.errstate(over="ignore"):  # what is too far for a number is beyond the range
        millimetres = np.clip(np.where(known, depth_m, 0.0) * np.float32(1000.0), 0, DEPTH_LIMIT_MM)
    rounded = np.rint(millimetres).astype(np.uint16)
    rounded[known & (rounded == UNKNOWN_MM)] = 1
    return rounded
