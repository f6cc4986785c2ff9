"""Depth in metres from every encoding people store CARLA's depth in. Decided by content, once for a sensor.

Sources: CARLA's documentation of the depth camera (24 bits, metres = (R + 256 G + 65536 B) / (2^24 - 1) * 1000) and its
colour converters ``LogarithmicDepth`` (grey = 1 + ln(metres / 1000) / 5.70378) and ``Depth`` (grey = metres / 1000).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float32
from roadperc_stream.errors import DumpError

from .pixel_files import Pixels, surveyed

DepthEncoding = Literal[
    "carla 24 bit",
    "millimetres",
    "metres",
    "metres / 1000",
    "logarithmic grey",
    "linear grey to 1000 m",
    "linear grey to 50 m",
]

FAR_PLANE_M: Final = 1000.0
CLIPPED_M: Final = 50.0
"""Far plane of TransFuser's 8-bit depth."""
LOG_SCALE: Final = 5.70378
GREY: Final[Mapping[DepthEncoding, str]] = {
    "logarithmic grey": "known to about 2 %",
    "linear grey to 1000 m": "known to 2 m",
    "linear grey to 50 m": "known to 0.1 m, to 50 m",
}
"""How well the codings of 8 bits tell the depth."""
_NUMBERS: Final = frozenset({"metres", "metres / 1000"})
_LARGEST_CODE: Final = 2**24 - 1


def depth_encoding(files: Sequence[Path]) -> DepthEncoding:
    """Encoding of a sensor's files, from the first that tells; 8-bit grey counts as logarithmic (see ``grey_depth``).

    Raises:
        DumpError: no file can be read, or the content is no depth.

    """
    samples = surveyed(files)
    found = [encoding for pixels in samples if (encoding := _encoding(pixels))]
    if "metres" in found and set(found) <= _NUMBERS:
        return "metres"
    return found[0] if found else ("metres" if samples[0].values.dtype.kind == "f" else "carla 24 bit")


def _encoding(pixels: Pixels) -> DepthEncoding | None:
    """None where a file alone does not tell: all black or white, such as a frame of sky, or nothing known."""
    values = pixels.values
    if values.dtype.kind == "f" and pixels.channels == 1:
        return _number_encoding(values)
    if values.dtype == np.uint16 and pixels.channels == 1:
        return "millimetres"
    if values.dtype == np.uint8 and pixels.container == "npy" and pixels.channels == 4:
        return "carla 24 bit"
    if values.dtype == np.uint8 and pixels.container in ("png", "jpeg"):
        return _colour_encoding(pixels)
    raise DumpError(f"{pixels.path}: {pixels.shape} is no depth encoding known")


def _number_encoding(values: NDArray[np.floating]) -> DepthEncoding | None:
    """A road scene reaches beyond 1 m, and metres / 1000 never beyond 1, which is CARLA's far plane."""
    known = values[values > 0]
    if not known.size:
        return None
    return "metres" if known.max() > 1.0 else "metres / 1000"


def _colour_encoding(pixels: Pixels) -> DepthEncoding | None:
    if pixels.channels == 1 and not _coloured(pixels):
        return "logarithmic grey"
    if pixels.channels in (3, 4) and pixels.equal_channels():
        grey = pixels.values[..., 0]
        return "logarithmic grey" if ((grey > 0) & (grey < 255)).any() else None
    if pixels.container == "jpeg" or pixels.channels not in (3, 4):
        raise DumpError(f"{pixels.path}: {pixels.shape} with colours: only a PNG keeps 24-bit depth")
    return "carla 24 bit"


def _coloured(pixels: Pixels) -> bool:
    return any(len(set(colour)) > 1 for colour in pixels.palette)


def depth_metres(pixels: Pixels, encoding: DepthEncoding) -> Float32:
    """(H, W) float32 metres; NaN unknown.

    Raises:
        DumpError: this file is not encoded as the sensor's others.

    """
    own = _encoding(pixels)
    same = own == encoding or (own in GREY and encoding in GREY)
    if not same and own is not None and not (own in _NUMBERS and encoding == "metres"):
        raise DumpError(f"{pixels.path}: depth as {own}, the files before as {encoding}")
    match encoding:
        case "carla 24 bit":
            return carla_metres(pixels.values)
        case "logarithmic grey":
            return logarithmic_metres(grey_of(pixels))
        case "linear grey to 1000 m" | "linear grey to 50 m":
            return linear_metres(grey_of(pixels), FAR_PLANE_M if encoding == "linear grey to 1000 m" else CLIPPED_M)
        case "millimetres":
            return _known(pixels.values.astype(np.float32) * np.float32(0.001))
        case "metres":
            return _known(pixels.values.astype(np.float32))
        case "metres / 1000":
            return _known((pixels.values * FAR_PLANE_M).astype(np.float32))


def carla_metres(pixels: NDArray[np.uint8]) -> Float32:
    """(H, W) float32 metres of (H, W, 3 or 4) blue, green, red (alpha).

    In memory the bytes are the number itself, the big end first.
    """
    bgra = cv2.cvtColor(pixels, cv2.COLOR_BGR2BGRA) if pixels.shape[2] == 3 else np.ascontiguousarray(pixels)
    codes = bgra.view(">u4")[..., 0] >> 8
    return _known(codes.astype(np.float32) * np.float32(FAR_PLANE_M / _LARGEST_CODE))


def logarithmic_metres(grey: NDArray[np.uint8]) -> Float32:
    """(H, W) float32 metres of (H, W) grey."""
    levels = np.arange(256, dtype=np.float64) / 255.0
    table = FAR_PLANE_M * np.exp((levels - 1.0) * LOG_SCALE)
    result: Float32 = table.astype(np.float32)[grey]
    return result


def linear_metres(grey: NDArray[np.uint8], far_m: float) -> Float32:
    """(H, W) float32 metres of (H, W) grey; black is no depth, and so is white where it says that depth was cut off."""
    depth_m = _known(grey.astype(np.float32) * np.float32(far_m / 255))
    if far_m < FAR_PLANE_M:
        depth_m[grey == np.iinfo(np.uint8).max] = np.nan
    return depth_m


def grey_of(pixels: Pixels) -> NDArray[np.uint8]:
    """(H, W) grey levels of an image whose channels are equal."""
    if pixels.palette:
        levels = np.zeros(256, np.uint8)
        levels[: len(pixels.palette)] = [colour[0] for colour in pixels.palette]
        return np.asarray(levels[pixels.values])
    grey: NDArray[np.uint8] = pixels.values if pixels.channels == 1 else pixels.values[..., 0]
    return grey


def _known(depth_m: Float32) -> Float32:
    """Zero and below is no depth."""
    depth_m[~(depth_m > 0)] = np.nan
    return depth_m
