"""Pixels in and out of their encodings. OpenCV is imported with the first image that is decoded."""

import io
import warnings
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, UnidentifiedImageError
from PIL import Image as PillowImage

from roadperc_stream.core.datatypes import Image
from roadperc_stream.core.geometry import Float32
from roadperc_stream.core.semantics import Colour
from roadperc_stream.errors import DecodeError

DEPTH_LIMIT_MM: Final = 65535
UNKNOWN_MM: Final = 0
PNG_MAGIC: Final = b"\x89PNG\r\n\x1a\n"
_PALETTE_ENTRIES: Final = 256
_LAST_UPRIGHT: Final = 4
"""EXIF orientations beyond exchange rows and columns."""


def decode_bgr(data: bytes) -> Image:
    """(H, W, 3) uint8 of an encoded image.

    Raises:
        DecodeError: OpenCV reads no image from the bytes.
    """
    return _decoded(data, "IMREAD_COLOR")


def decode_grey(data: bytes) -> Image:
    """(H, W) uint8 of an encoded image: a JPEG's colours are not even decoded.

    Raises:
        DecodeError: OpenCV reads no image from the bytes.
    """
    return _decoded(data, "IMREAD_GRAYSCALE")


def _decoded(data: bytes, mode: str) -> Image:
    pixels = _pixels(data, mode)
    if pixels is None:
        raise DecodeError(f"{len(data)} bytes are no image")
    return pixels.astype(np.uint8, copy=False)


def decode_unchanged(data: bytes) -> NDArray[Any] | None:
    """Pixels as they are encoded; None of what OpenCV does not read."""
    return _pixels(data, "IMREAD_UNCHANGED")


def image_size(data: bytes) -> tuple[int, int]:
    """Columns and rows of an encoded image by its header, as OpenCV would turn it.

    Raises:
        DecodeError: no image, or a header that claims a hundred million pixels or more.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", PillowImage.DecompressionBombWarning)
            with PillowImage.open(io.BytesIO(data)) as image:
                turned = image.getexif().get(ExifTags.Base.Orientation, 1) > _LAST_UPRIGHT
                return (image.height, image.width) if turned else (image.width, image.height)
    except (PillowImage.DecompressionBombWarning, PillowImage.DecompressionBombError) as error:
        raise DecodeError(f"{len(data)} bytes claim to be an image of a hundred million pixels or more") from error
    except (OSError, ValueError, SyntaxError) as error:
        raise DecodeError(f"{len(data)} bytes are no image") from error


def _pixels(data: bytes, mode: str) -> NDArray[Any] | None:
    """Pixels as OpenCV's ``mode`` has them; None of what it does not read, such as a billion pixels."""
    import cv2

    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), getattr(cv2, mode)) if data else None
    except cv2.error:
        return None


def decode_indices(data: bytes) -> Image:
    """(H, W) uint8 indices of a palette PNG, or the grey values of a grey one.

    Raises:
        DecodeError: no image, or one without indices.

    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", PillowImage.DecompressionBombWarning)
            # No other format: a JPEG's or GIF's greys are no tags.
            with PillowImage.open(io.BytesIO(data), formats=("PNG",)) as image:
                if image.mode not in ("P", "L"):
                    raise DecodeError(f"image of mode {image.mode}: expected palette indices (P) or grey tags (L)")
                return np.array(image)
    except (PillowImage.DecompressionBombWarning, PillowImage.DecompressionBombError) as error:
        raise DecodeError(f"{len(data)} bytes claim to be an image of a hundred million pixels or more") from error
    except UnidentifiedImageError as error:
        raise DecodeError(f"{len(data)} bytes are no PNG, they start with {data[:4].hex()}") from error
    except (OSError, ValueError, SyntaxError) as error:
        raise DecodeError(f"{len(data)} bytes are no whole PNG: {error}") from error


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
