"""Depth in metres from the usual encodings of depth. The content decides, once for each sensor, or the user.

``METRES`` is the table of encodings. To read another one, add its name and its function there.

The ground shows which coding an 8-bit grey image has. In a level camera, a row below the horizon shows the road at
h fy / (row - horizon) metres. Each coding predicts a grey level for each row. Only the right coding fits the rows with
a plausible camera height. With a wrong coding the ground is curved, or the camera is metres too low or too high.

Sources: CARLA's documentation of the depth camera (24 bits, metres = (R + 256 G + 65536 B) / (2^24 - 1) * 1000) and its
colour converters ``LogarithmicDepth`` (grey = 1 + ln(metres / 1000) / 5.70378) and ``Depth`` (grey = metres / 1000);
TransFuser, which clips CARLA's depth at 50 m and spreads that over the greys.

Raises everywhere:
    DumpError: the content is no depth, or in another encoding than the user or the sensor's other files say.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, Literal, cast, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Camera, Float, Float32

from .pixel_files import Pixels, samples_of

Unit = Literal["mm", "cm", "m", "depth-256", "tum", "disparity"]
GreyDepth = Literal["linear", "linear-50", "logarithmic"]
DepthCoding = GreyDepth | Unit
DepthEncoding = Literal[
    Unit,
    "carla 24 bit",
    "millimetres",
    "metres",
    "metres / 1000",
    "logarithmic grey",
    "linear grey to 1000 m",
    "linear grey to 50 m",
    "linear grey to 255 m",
]

FAR_PLANE_M: Final = 1000.0
CLIPPED_M: Final = 50.0
"""Far plane of TransFuser's 8-bit depth."""
LOG_SCALE: Final = 5.70378
_WHITE: Final = 255
_UNITS: Final = get_args(Unit)
"""Encodings of numbers that only the user knows."""
_NUMBERS: Final = frozenset({"metres", "metres / 1000", "millimetres"})
GREY: Final[Mapping[DepthEncoding, str]] = {
    "logarithmic grey": "known to about 2 %",
    "linear grey to 1000 m": "known to 2 m",
    "linear grey to 50 m": "known to 0.1 m, to 50 m",
    "linear grey to 255 m": "known to 0.5 m",
}
"""Precision of the 8-bit encodings."""
GREY_ENCODINGS: Final[Mapping[str | None, DepthEncoding]] = {
    "linear": "linear grey to 1000 m",
    "linear-50": "linear grey to 50 m",
    "logarithmic": "logarithmic grey",
}
"""Encoding by the user's name for it."""
_FARTHEST_MEDIAN_M: Final = 1000.0
_LARGEST_CODE: Final = 2**24 - 1


def carla_metres(pixels: NDArray[np.uint8]) -> Float32:
    """Return (H, W) float32 metres of (H, W, 3 or 4) blue, green, red (alpha): a big-endian number in memory."""
    bgra = cv2.cvtColor(pixels, cv2.COLOR_BGR2BGRA) if pixels.shape[2] == 3 else np.ascontiguousarray(pixels)
    codes = bgra.view(">u4")[..., 0] >> 8
    return _known(codes.astype(np.float32) * np.float32(FAR_PLANE_M / _LARGEST_CODE))


def _scaled(factor: float, pixels: Pixels) -> Float32:
    scaled: Float32 = pixels.values.astype(np.float32) * np.float32(factor)
    return scaled


def _clipped_grey(white_m: float, pixels: Pixels) -> Float32:
    """Return metres of levels whose white is clipped depth: unknown, ``white_m`` or more."""
    grey = grey_of(pixels)
    depth_m: Float32 = grey.astype(np.float32) * np.float32(white_m / _WHITE)
    depth_m[grey == _WHITE] = np.nan
    return depth_m


def _logarithmic_grey(pixels: Pixels) -> Float32:
    levels = np.arange(_WHITE + 1, dtype=np.float64) / _WHITE
    metres: Float32 = (FAR_PLANE_M * np.exp((levels - 1.0) * LOG_SCALE)).astype(np.float32)
    return metres[grey_of(pixels)]


METRES: Final[Mapping[DepthEncoding, Callable[[Pixels], Float32]]] = {
    "carla 24 bit": lambda pixels: carla_metres(pixels.values),
    "millimetres": partial(_scaled, 0.001),
    "metres": partial(_scaled, 1.0),
    "metres / 1000": lambda pixels: (pixels.values * FAR_PLANE_M).astype(np.float32),
    "logarithmic grey": _logarithmic_grey,
    "linear grey to 1000 m": lambda pixels: grey_of(pixels).astype(np.float32) * np.float32(FAR_PLANE_M / _WHITE),
    "linear grey to 50 m": partial(_clipped_grey, CLIPPED_M),
    "linear grey to 255 m": partial(_clipped_grey, 255.0),  # Bench2Drive's levels are whole metres
    "mm": partial(_scaled, 0.001),
    "cm": partial(_scaled, 0.01),
    "m": partial(_scaled, 1.0),
    "depth-256": partial(_scaled, 1 / 256),  # KITTI has 256 steps a metre or pixel
    "tum": partial(_scaled, 1 / 5000),  # TUM's RGB-D benchmark has 5000 steps a metre
    "disparity": partial(_scaled, 1 / 256),  # pixels
}
"""Metres of a file by its encoding, (H, W) float32; for disparity pixels."""


def depth_metres(pixels: Pixels, encoding: DepthEncoding, focal_baseline: float = np.nan) -> Float32:
    """Return (H, W) float32 metres; NaN is unknown.

    ``focal_baseline`` is the focal length in pixels times the baseline in metres, for disparity.
    """
    own = _encoding(pixels)
    if not _fits(own, encoding):
        raise DumpError(f"{pixels.path}: depth is encoded as {own}, the files before as {encoding}")
    depth_m = _known(METRES[encoding](pixels))
    return _known(np.float32(focal_baseline) / depth_m) if encoding == "disparity" else depth_m


def _fits(own: DepthEncoding | None, encoding: DepthEncoding) -> bool:
    """Return True if a file with its ``own`` encoding can be read as another one."""
    if own in GREY and encoding in GREY:
        return True
    if own in _NUMBERS and encoding in _UNITS:
        return True
    return own in (None, encoding) or (own == "metres / 1000" and encoding == "metres")


def grey_of(pixels: Pixels) -> NDArray[np.uint8]:
    """Return (H, W) grey levels of an image with equal channels."""
    if pixels.palette:
        levels = np.zeros(256, np.uint8)
        levels[: len(pixels.palette)] = [colour[0] for colour in pixels.palette]
        return np.asarray(levels[pixels.values])
    grey: NDArray[np.uint8] = pixels.values if pixels.channels == 1 else pixels.values[..., 0]
    return grey


def _known(depth_m: Float32) -> Float32:
    """Replace depth of 0 or below by NaN, in place."""
    depth_m[~(depth_m > 0)] = np.nan
    return depth_m


def depth_encoding(files: Sequence[Path], asked: DepthCoding | None = None) -> DepthEncoding:
    """Return the encoding of a sensor's files; 8-bit grey counts as logarithmic (see ``grey_encoding``).

    ``asked`` is the user's choice.
    """
    samples = samples_of(files)
    found = [encoding for pixels in samples if (encoding := _encoding(pixels))]
    if asked in _UNITS:
        if other := next((encoding for encoding in found if encoding not in _NUMBERS), None):
            raise DumpError(f"{files[0]}: depth is encoded as {other}, but --depth-coding {asked} is for numbers")
        return cast("Unit", asked)
    if "metres" in found and (median := max(map(_median, samples))) > _FARTHEST_MEDIAN_M:
        raise DumpError(f"{files[0]}: the median is {median:g}: pass --depth-coding mm, cm, m, tum or disparity")
    if "metres" in found and set(found) <= {"metres", "metres / 1000"}:
        return "metres"
    return found[0] if found else ("metres" if samples[0].values.dtype.kind == "f" else "carla 24 bit")


def _encoding(pixels: Pixels) -> DepthEncoding | None:
    """Return the encoding of a file; None if it is ambiguous: all black or white (such as sky)."""
    values = pixels.values
    if values.dtype.kind == "f" and pixels.channels == 1:
        # Values of a road in metres exceed 1. Values in metres / 1000 do not: CARLA's far plane is at 1.
        known = values[values > 0]
        return ("metres" if known.max() > 1.0 else "metres / 1000") if known.size else None
    if pixels.channels == 1 and values.dtype.kind in "iu" and values.dtype.itemsize > 1:
        return "millimetres"
    if values.dtype == np.uint8 and pixels.container == "npy" and pixels.channels == 4:
        return "carla 24 bit"
    if values.dtype == np.uint8 and pixels.container in ("png", "jpeg"):
        return _colour_encoding(pixels)
    raise DumpError(f"{pixels.path}: {pixels.shape} is not a known depth encoding")


def _colour_encoding(pixels: Pixels) -> DepthEncoding | None:
    if pixels.channels == 1 and all(len(set(colour)) == 1 for colour in pixels.palette):
        return "logarithmic grey"
    if pixels.channels in (3, 4) and pixels.equal_channels():
        grey = pixels.values[..., 0]
        return "logarithmic grey" if ((grey > 0) & (grey < _WHITE)).any() else None
    if pixels.container == "jpeg" or pixels.channels not in (3, 4):
        raise DumpError(
            f"{pixels.path}: {pixels.shape} with colours is not depth; CARLA's 24-bit depth needs a PNG of 8 bits"
        )
    return "carla 24 bit"


def _median(pixels: Pixels) -> float:
    known = pixels.values[np.isfinite(pixels.values) & (pixels.values > 0)]
    return float(np.median(known)) if known.size else 0.0


_GREY_OF: Final[Mapping[GreyDepth, Callable[[Float], Float]]] = {
    "linear": lambda metres: metres / FAR_PLANE_M,
    "linear-50": lambda metres: metres / CLIPPED_M,
    "logarithmic": lambda metres: 1.0 + np.log(metres / FAR_PLANE_M) / LOG_SCALE,
}
_HEIGHTS_M: Final = np.geomspace(1.0, 4.0, 33)
"""Tried heights of the camera, as on cars and lorries."""
_HORIZON_SHARE: Final = 0.1
"""Largest distance of the horizon from the principal point, share of the image's height: 5 degrees or more."""
_HORIZONS: Final = 61
_BELOW: Final = 0.03
"""First compared row: distance below the principal point, share of the image's height."""
_MIDDLE: Final = 1 / 3
"""Share of the columns that is compared, in the centre, which shows road."""
_MIN_ROWS: Final = 8
_MOST_OFF: Final = 3.0
"""Largest mean error of a coding over the rows, grey levels."""
_MOST_COUNTED: Final = 20.0
"""Limit of a row's error in the mean, grey levels, because a car may cover the road."""
_TIMES_BETTER: Final = 2.0
_FINEST: Final = 0.3
"""Smaller errors do not distinguish codings, because grey levels are integers."""


def grey_encoding(files: Sequence[Path], camera: Camera, asked: DepthCoding | None) -> tuple[DepthEncoding, str]:
    """Return the coding of a sensor's 8-bit grey files, and the reason for it; ``asked`` is the user's choice.

    It is an error if the user chose none, and the ground does not show it.
    """
    if asked in GREY_ENCODINGS:
        return GREY_ENCODINGS[asked], f"8-bit depth is {GREY_ENCODINGS[asked]}: --depth-coding {asked}"
    rows, levels = _ground_levels(samples_of(files), camera)
    off = {name: _off(name, rows, levels, camera) for name in _GREY_OF} if len(rows) >= _MIN_ROWS else {}
    ranked = sorted(off, key=lambda name: off[name])
    found = ", ".join(f"{name} {off[name]:.1f}" for name in ranked)
    if not ranked or off[ranked[0]] > _MOST_OFF or off[ranked[1]] < _TIMES_BETTER * max(off[ranked[0]], _FINEST):
        reason = f"errors of a level ground in grey levels: {found}" if found else "it shows no ground"
        raise DumpError(
            f"{files[0]}: the coding of 8-bit grey depth is unknown ({reason}); pass --depth-coding linear (to 1000 m, "
            "CARLA's ColorConverter.Depth), linear-50 (to 50 m, TransFuser) or logarithmic"
        )
    best = GREY_ENCODINGS[ranked[0]]
    return best, f"8-bit depth is {best}; errors of a level ground in grey levels: {found}"


def _ground_levels(samples: Sequence[Pixels], camera: Camera) -> tuple[Float, Float]:
    """Return rows below the horizon and their median grey levels, of all files in order, without white rows."""
    first = int(np.ceil(camera.cy + _BELOW * camera.height))
    left = int(camera.width * (1 - _MIDDLE) / 2)
    greys = [grey for pixels in samples if (grey := grey_of(pixels)).shape == camera.size]
    medians = [np.median(grey[first:, left : camera.width - left], axis=1) for grey in greys]
    levels: Float = np.concatenate([np.empty(0), *medians])
    rows = np.tile(np.arange(first, max(camera.height, first), dtype=float), len(medians))
    known = levels < _WHITE
    return (rows[known], levels[known]) if known.any() and np.ptp(levels[known]) > 0 else (rows[:0], levels[:0])


def _off(name: GreyDepth, rows: Float, levels: Float, camera: Camera) -> float:
    """Return the mean difference in grey levels from the best-fitting level ground."""
    spread = _HORIZON_SHARE * camera.height
    horizons = np.linspace(camera.cy - spread, camera.cy + spread, _HORIZONS)
    below = np.maximum(rows - horizons[:, None], _HEIGHTS_M[0] * camera.fy / FAR_PLANE_M)
    expected = np.clip(np.rint(255.0 * _GREY_OF[name](_HEIGHTS_M[:, None, None] * camera.fy / below)), 0.0, 255.0)
    return float(np.minimum(np.abs(expected - levels), _MOST_COUNTED).mean(axis=-1).min())
