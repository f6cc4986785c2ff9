"""Pixels in and out of their encodings.

OpenCV is imported with the first image that is decoded, Pillow with the first that neither it nor ``png`` reads.
"""

import io
import struct
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.core.datatypes import Ids, Image
from roadperc_stream.core.geometry import Float32
from roadperc_stream.core.kernels.depth import metres_of_mm, mm_of_metres
from roadperc_stream.core.semantics import Colour
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import png

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

PNG_MAGIC: Final = png.MAGIC
_JPEG_MAGIC: Final = b"\xff\xd8"
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
"""By the mode of OpenCV that they take the place of, for the PNGs that they read."""
_LAST_UPRIGHT: Final = 4
"""EXIF orientations beyond exchange rows and columns."""
_PILLOWS_WARNINGS: Final = threading.RLock()


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
    from PIL import ExifTags

    with _opened(data) as image:
        turned = image.getexif().get(ExifTags.Base.Orientation, 1) > _LAST_UPRIGHT
        return (image.height, image.width) if turned else (image.width, image.height)


@contextmanager
def _opened(data: bytes, formats: tuple[str, ...] | None = None) -> Iterator["PillowImage"]:
    """An image file with its header read.

    Raises:
        DecodeError: no image of these formats.
    """
    from PIL import Image as Pillow
    from PIL import UnidentifiedImageError

    kind = formats[0] if formats else "image"
    try:
        # the filters are the process's: two threads that change them at once would leave them changed
        with _PILLOWS_WARNINGS, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what it reads all the same; the limits say what is too large
            with Pillow.open(io.BytesIO(data), formats=formats) as image:
                yield image
    except UnidentifiedImageError as error:
        raise DecodeError(f"{len(data)} bytes are no {kind}, they start with {data[:4].hex()}") from error
    except (OSError, ValueError, SyntaxError, struct.error, Pillow.DecompressionBombError) as error:
        raise DecodeError(f"{len(data)} bytes are no whole {kind}: {error}") from error


def _header_size(data: bytes) -> tuple[int, int]:
    """Columns and rows as they are stored. Of PNG and JPEG it is read here: Pillow takes a quarter millisecond.

    Raises:
        DecodeError: no image.
    """
    if data.startswith(PNG_MAGIC) and len(data) >= png.SIZE.size + png.SIZE_AT:
        width, height = png.SIZE.unpack_from(data, png.SIZE_AT)
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
    pixels = _PNG_READERS[mode](data)
    if pixels is not None:
        return pixels
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
        tags = png.indices(data)
        if tags is not None:
            return tags
    # No other format: a JPEG's or GIF's greys are no tags.
    with _opened(data, ("PNG",)) as image:
        if image.mode not in ("P", "L"):
            raise DecodeError(f"image of mode {image.mode}: expected palette indices (P) or grey tags (L)")
        return np.array(image)


def instance_ids(bgr: Image) -> Ids:
    """(H, W) numbers of CARLA's coding: green is the low byte, blue the high one; red, the tag, is left to others.

    Source: CARLA's documentation, "Instance segmentation camera".
    """
    import cv2

    low_high = np.empty((*bgr.shape[:2], 2), np.uint8)
    cv2.mixChannels([bgr], [low_high], [1, 0, 0, 1])  # from channel 1 to 0, from 0 to 1
    return low_high.view("<u2")[..., 0].astype(np.uint16, copy=False)


def encode_indices(indices: Image, colours: tuple[Colour, ...]) -> bytes:
    """Palette PNG of (H, W) uint8 indices: label images show their colours in every viewer."""
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


def depth_from_mm(depth_mm: NDArray[np.uint16]) -> Float32:
    """(H, W) metres of 16-bit millimetres: NaN for 0; 65535 stands for 65.535 m or more."""
    depth_m = np.empty(depth_mm.shape, np.float32)
    aligned = np.require(depth_mm, np.uint16, ["C_CONTIGUOUS", "ALIGNED"])  # in a message they begin at any byte
    metres_of_mm(aligned, depth_m)
    return depth_m


def depth_to_mm(depth_m: Float32) -> NDArray[np.uint16]:
    """(H, W) 16-bit millimetres: unknown (NaN, not positive) becomes 0, what lies beyond the range 65535."""
    depth_mm = np.empty(depth_m.shape, np.uint16)
    mm_of_metres(np.ascontiguousarray(depth_m), depth_mm)
    return depth_mm
