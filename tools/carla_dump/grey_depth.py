"""Which of the codings of 8-bit grey depth a dump has: they are told apart by the ground they imply.

Below the horizon a level camera sees a road at h fy / (row - horizon) metres. Each coding says which grey that is, and
only the right one explains the rows that are there with a camera of a plausible height: under another one the ground
would be curved, or the camera metres below or above any car's.

Sources: CARLA's colour converters ``Depth`` and ``LogarithmicDepth``; TransFuser, which clips CARLA's depth at 50 m and
spreads that over the greys.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np

from roadperc_stream.core.geometry import Camera, Float
from roadperc_stream.errors import DumpError

from .depth_files import CLIPPED_M, FAR_PLANE_M, LOG_SCALE, DepthEncoding, grey_of
from .pixel_files import Pixels, surveyed

GreyDepth = Literal["linear", "linear-50", "logarithmic"]

ENCODINGS: Final[Mapping[GreyDepth, DepthEncoding]] = {
    "linear": "linear grey to 1000 m",
    "linear-50": "linear grey to 50 m",
    "logarithmic": "logarithmic grey",
}
_GREY_OF: Final[Mapping[GreyDepth, Callable[[Float], Float]]] = {
    "linear": lambda metres: metres / FAR_PLANE_M,
    "linear-50": lambda metres: metres / CLIPPED_M,
    "logarithmic": lambda metres: 1.0 + np.log(metres / FAR_PLANE_M) / LOG_SCALE,
}
_HEIGHTS_M: Final = np.geomspace(1.0, 4.0, 33)
"""Of cameras on cars and lorries."""
_HORIZON_SHARE: Final = 0.1
"""Part of the image's height by which the horizon may lie off the principal point: a pitch of 5 degrees or more."""
_HORIZONS: Final = 61
_BELOW: Final = 0.03
"""Part of the image's height below the principal point from which rows are compared."""
_MIDDLE: Final = 1 / 3
"""Part of the columns that is looked at: in the middle there is road."""
_MIN_ROWS: Final = 8
_MOST_OFF: Final = 3.0
"""Grey levels in the mean over rows by which a coding's ground may be off."""
_MOST_COUNTED: Final = 20.0
"""Grey levels that a row counts at most: a car may stand on the road."""
_TIMES_BETTER: Final = 2.0
_FINEST: Final = 0.3
"""Grey levels below which one coding is no better than another: they are whole."""


def grey_encoding(files: Sequence[Path], camera: Camera, asked: GreyDepth | None) -> tuple[DepthEncoding, str]:
    """The coding of a sensor's 8-bit grey files, and why it was taken.

    Args:
        files: of the sensor.
        camera: its camera.
        asked: what the user says.

    Raises:
        DumpError: nobody says, and the ground does not tell.
    """
    if asked is not None:
        return ENCODINGS[asked], f"8-bit depth is {ENCODINGS[asked]}: --grey-depth {asked}"
    rows, levels = _ground_levels(surveyed(files), camera)
    off = {name: _off(name, rows, levels, camera) for name in ENCODINGS} if len(rows) >= _MIN_ROWS else {}
    ranked = sorted(off, key=lambda name: off[name])
    found = ", ".join(f"as {name} by {off[name]:.1f}" for name in ranked)
    if not ranked or off[ranked[0]] > _MOST_OFF or off[ranked[1]] < _TIMES_BETTER * max(off[ranked[0]], _FINEST):
        why = f"greys of a level ground would be off {found}" if found else "it shows no ground"
        raise DumpError(
            f"{files[0]}: 8-bit grey depth, and nothing tells its coding ({why}): say --grey-depth linear (to 1000 m, "
            "CARLA's ColorConverter.Depth), linear-50 (to 50 m, TransFuser) or logarithmic"
        )
    return ENCODINGS[ranked[0]], f"8-bit depth is {ENCODINGS[ranked[0]]}: greys of a level ground are off {found}"


def _ground_levels(samples: Sequence[Pixels], camera: Camera) -> tuple[Float, Float]:
    """Rows below the horizon and their median grey levels, of all files one after the other; white says nothing."""
    first = int(np.ceil(camera.cy + _BELOW * camera.height))
    left = int(camera.width * (1 - _MIDDLE) / 2)
    greys = [grey for pixels in samples if (grey := grey_of(pixels)).shape == camera.size]
    medians = [np.median(grey[first:, left : camera.width - left], axis=1) for grey in greys]
    levels: Float = np.concatenate([np.empty(0), *medians])
    rows = np.tile(np.arange(first, max(camera.height, first), dtype=float), len(medians))
    told = levels < np.iinfo(np.uint8).max
    return (rows[told], levels[told]) if told.any() and np.ptp(levels[told]) > 0 else (rows[:0], levels[:0])


def _off(name: GreyDepth, rows: Float, levels: Float, camera: Camera) -> float:
    """Mean difference in grey levels from the level ground that fits best."""
    spread = _HORIZON_SHARE * camera.height
    horizons = np.linspace(camera.cy - spread, camera.cy + spread, _HORIZONS)
    below = np.maximum(rows - horizons[:, None], _HEIGHTS_M[0] * camera.fy / FAR_PLANE_M)
    expected = np.clip(np.rint(255.0 * _GREY_OF[name](_HEIGHTS_M[:, None, None] * camera.fy / below)), 0.0, 255.0)
    return float(np.minimum(np.abs(expected - levels), _MOST_COUNTED).mean(axis=-1).min())
