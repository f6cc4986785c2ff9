"""Format, size and completeness of image files, without decoding pixels.

Raises everywhere:
    UnreadableFrameError: the file is empty, cut off, damaged, or neither PNG nor JPEG; the message names it.
"""

import struct
import zlib
from pathlib import Path
from typing import Final, Literal

from PIL import Image as PillowImage

from roadperc_stream.errors import DumpError
from roadperc_stream.formats.images import PNG_MAGIC, format_of
from roadperc_stream.system.files import open_file, read_file

ImageFormat = Literal["png", "jpeg"]
_PNG_MODES: Final = {0: "grey", 2: "RGB", 3: "palette", 4: "grey + alpha", 6: "RGBA"}
_TAIL_BYTES: Final = 1024
_MOST_BYTES: Final = 1024**3
"""Largest file of a frame; a larger message would be beyond ``limits.record_mb``."""


class UnreadableFrameError(DumpError):
    """A single unreadable file: it is reported and counted as missing, and the conversion continues."""


def read_bytes(path: Path) -> bytes:
    """Return the content of a frame's file."""
    try:
        return read_file(path, _MOST_BYTES)
    except OSError as error:
        raise UnreadableFrameError(f"{path}: {error.strerror or error}") from error


def first_bytes(path: Path, count: int) -> bytes:
    """Return the first bytes of a frame's file."""
    try:
        with open_file(path) as stream:
            return stream.read(count)
    except OSError as error:
        raise UnreadableFrameError(f"{path}: {error.strerror or error}") from error


def read_header(path: Path) -> tuple[tuple[int, int], str]:
    """Return columns and rows of an image file, and its encoding in words; reads only the first and last bytes."""
    try:
        with open_file(path) as stream:
            head = stream.read(32)
            form = _image_format(path, head)
            stream.seek(0, 2)
            stream.seek(max(stream.tell() - _TAIL_BYTES, 0))
            _require_end(path, form, stream.read())
        if form == "png":
            width, height, bits, mode = struct.unpack_from(">IIBB", head, 16)
            return (width, height), f"png {_PNG_MODES.get(mode, '?')} {bits} bit"
        with PillowImage.open(path, formats=("JPEG",)) as image:
            return image.size, f"jpeg {'grey' if image.mode == 'L' else 'colour'}"
    except (OSError, struct.error, PillowImage.DecompressionBombError) as error:
        raise UnreadableFrameError(f"{path}: {error}") from error


def require_whole(path: Path, data: bytes) -> ImageFormat:
    """Check that an image is complete (checksums of a PNG, end of a JPEG), and return its format."""
    form = _image_format(path, data)
    if form == "png":
        _check_png_chunks(path, data)
    else:
        _require_end(path, form, data[-_TAIL_BYTES:])
    return form


def _image_format(path: Path, data: bytes) -> ImageFormat:
    name = format_of(data)
    if name in ("PNG", "JPEG"):
        return "png" if name == "PNG" else "jpeg"
    found = f"{name} image" if name else f"not an image (starts with {data[:8].hex(' ')})" if data else "empty file"
    raise UnreadableFrameError(f"{path}: {found}, expected PNG or JPEG")


def _require_end(path: Path, form: ImageFormat, tail: bytes) -> None:
    if (b"IEND" if form == "png" else b"\xff\xd9") not in tail:
        raise UnreadableFrameError(f"{path}: {form} is cut off")


def _check_png_chunks(path: Path, data: bytes) -> None:
    """Check the chunks (length, type, data, CRC) up to IEND."""
    view, at = memoryview(data), len(PNG_MAGIC)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            break
        if zlib.crc32(view[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            raise UnreadableFrameError(f"{path}: png is damaged (checksum at byte {at})")
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end + 4
    raise UnreadableFrameError(f"{path}: png is cut off")
