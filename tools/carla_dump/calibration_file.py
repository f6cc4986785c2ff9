"""Read ``calibration.json``; compute pinholes from K, a field of view or projection matrices."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import AliasChoices, BeforeValidator, Field, FiniteFloat, PositiveInt, TypeAdapter

from roadperc_stream.config.settings import in_brief
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, baseline_of, decompose_projection
from roadperc_stream.system.text import nearest

from .json_files import Document, Numbers3, Numbers4, checked, read_json
from .truth_file import CarlaPose

CALIBRATION_NAME: Final = "calibration.json"
Positive = Annotated[float, Field(gt=0.0)]
FieldOfView = Annotated[float, Field(gt=0.0, lt=180.0)]
Pixels = Annotated[PositiveInt, Field(le=1_000_000)]
_HALF_PIXEL = 0.5
_ROUNDING_PX = 1e-9
"""Largest rounding error of a decomposition in a skew of zero."""
_FOCAL_DIGITS = 9
"""Decimals of a focal length, so that 90 degrees give exactly w / 2."""


def _rows(found: Any) -> Any:
    """Refuse values that are not rows, such as the nine numbers of a K in ROS."""
    if isinstance(found, (list, tuple)) and all(isinstance(row, (list, tuple)) for row in found):
        return found
    raise ValueError(f"expected 3 rows of numbers, [[...], [...], [...]], found {in_brief(found, 80)}")


Matrix3 = Annotated[tuple[Numbers3, Numbers3, Numbers3], BeforeValidator(_rows)]
Matrix34 = Annotated[tuple[Numbers4, Numbers4, Numbers4], BeforeValidator(_rows)]


class Intrinsics(Document):
    """The size of a camera, and its K or horizontal field of view. The names of a lens are those of CameraInfo."""

    width: Pixels | None = None
    height: Pixels | None = None
    K: Matrix3 | None = None
    D: tuple[FiniteFloat, ...] = ()
    distortion_model: str = "plumb_bob"
    R: Matrix3 | None = None
    P: Matrix34 | None = None
    fov_deg: FieldOfView | None = Field(None, validation_alias=AliasChoices("fov_deg", "fov"))


class CalibrationFile(Intrinsics):
    """All known keys of ``calibration.json``; other keys are notes."""

    P_left: Matrix34 | None = None
    P_right: Matrix34 | None = None
    baseline_m: Positive | None = None
    pixel_origin: Literal["corner", "centre", "center"] = "corner"
    """Origin of K's principal point: the first pixel's corner (CARLA: c = w / 2) or its centre."""
    cameras: dict[str, Intrinsics] = Field(default_factory=dict)
    """Cameras that differ from the front one, by role: ``{"depth": {"width": 800, "height": 600, "fov_deg": 90}}``."""
    mounting: dict[str, CarlaPose] = Field(default_factory=dict)
    rgb_height_m: FiniteFloat | None = None
    depth_height_m: FiniteFloat | None = None
    carla_tags: str | None = None
    rate_hz: Positive | None = None


_CAMERA_KEYS = (*Intrinsics.model_fields, "fov")
_KEYS = (*CalibrationFile.model_fields, "fov")
_MISSPELLED = 0.78
"""An unknown key is an error if it is more similar to a known one: ``widht`` has 0.8, ``fov_y`` 0.75 (a note)."""


Pinhole = tuple[float, float, float, float]
"""fx, fy, cx, cy in pixels, pixel centres at integers from 0."""


def load_calibration(path: Path) -> CalibrationFile:
    """Read ``calibration.json``.

    Raises:
        DumpError: the file is wrong; the message names file, key and error.
    """
    document = read_json(path)
    _refuse_misspelled(path, document)
    calibration = checked(path, TypeAdapter(CalibrationFile), document)
    for name, camera in {"": calibration, **calibration.cameras}.items():
        if camera.K is not None:
            require_pinhole(f"{path}: {f'cameras.{name}.' if name else ''}K", np.array(camera.K))
    if (calibration.P_left is None) != (calibration.P_right is None):
        raise DumpError(f"{path}: P_left and P_right: expected both or neither")
    return calibration


def _refuse_misspelled(path: Path, document: Any) -> None:
    """Check that no unknown key is similar to a known key; other unknown keys are notes.

    Raises:
        DumpError: a key is misspelled.
    """
    if not isinstance(document, dict):
        return
    cameras = document.get("cameras")
    parts = {"": (document, _KEYS), **{f"cameras.{n}.": (c, _CAMERA_KEYS) for n, c in _items(cameras)}}
    for place, (keys, known) in parts.items():
        for key in (key for key, _ in _items(keys) if key not in known):
            if meant := nearest(key, known, _MISSPELLED):
                raise DumpError(f"{path}: unknown key {place}{key}; did you mean {meant}?")


def _items(found: Any) -> list[tuple[str, Any]]:
    return list(found.items()) if isinstance(found, dict) else []


def require_pinhole(where: str, K: Float) -> None:
    """Check that a (3, 3) matrix is that of a camera without skew.

    Raises:
        DumpError: it is not; the message starts with ``where``.
    """
    upper = K[0, 1] == K[1, 0] == 0 and K[2].tolist() == [0, 0, 1]
    if not (upper and K[0, 0] > 0 and K[1, 1] > 0):
        raise DumpError(f"{where}: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {K.tolist()}")


def pinhole_of_K(K: Float, pixel_origin: str) -> Pinhole:
    """Return the pinhole of K, moved by half a pixel if the principal point counts from the pixel's corner."""
    shift = _HALF_PIXEL if pixel_origin == "corner" else 0.0
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]) - shift, float(K[1, 2]) - shift


def pinhole_of_fov(fov_deg: float, width: int, height: int) -> Pinhole:
    """Return a pinhole with square pixels: f = w / (2 tan(fov / 2)), principal point at the image's centre."""
    f = round(float(width / (2.0 * np.tan(np.deg2rad(fov_deg) / 2.0))), _FOCAL_DIGITS)
    return f, f, (width - 1) / 2.0, (height - 1) / 2.0


@dataclass(frozen=True)
class ProjectionPair:
    """A rectified stereo pair, from two projection matrices."""

    K_left: Float
    K_right: Float
    baseline_m: float
    along_rows: bool
    """True if the right camera lies along the first axis of the left one."""


def decompose_pair(path: Path, P_left: Float, P_right: Float) -> ProjectionPair:
    """Return K of both (3, 4) matrices, and the distance of their centres -M^-1 p4 with P = [M | p4] and M = K R.

    Raises:
        DumpError: a matrix is not a projection, or both have the same centre.
    """
    K_left, R_left, centre_left = _decompose(f"{path}: P_left", P_left)
    K_right, _, centre_right = _decompose(f"{path}: P_right", P_right)
    try:
        baseline_m = baseline_of(P_left, P_right)
    except ValueError as error:
        raise DumpError(f"{path}: P_left and P_right: {error}") from error
    offset = R_left @ (centre_right - centre_left)
    return ProjectionPair(K_left, K_right, baseline_m, bool(offset[0] > 0.99 * baseline_m))


def _decompose(where: str, P: Float) -> tuple[Float, Float, Float]:
    try:
        K, R, centre = decompose_projection(P)
    except ValueError as error:
        raise DumpError(f"{where}: {error}") from error
    K[np.abs(K) < _ROUNDING_PX] = 0.0
    require_pinhole(where, K)
    return K, R, centre
